"""Factors of what is known beforehand, and the gauge."""
