"""Posteriors as JSON, there and back."""
