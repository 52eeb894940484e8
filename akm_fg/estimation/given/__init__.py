"""What a fit is given: observations, knowledge, and where to start."""
