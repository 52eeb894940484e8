"""What is read to score answers: these, and the true joints. An estimator never sees a truth."""
