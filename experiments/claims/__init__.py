"""Whether what the estimator claims is true: probabilities, regions, other rigs."""
