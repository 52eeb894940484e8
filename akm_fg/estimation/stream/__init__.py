"""Frames one at a time: the posterior so far."""
