"""One joint kind: its graph, its solution, its covariance."""
