"""Which tracks and pixels move with the part."""
