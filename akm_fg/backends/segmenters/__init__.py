"""Object segmenters."""
