"""Dense features."""
