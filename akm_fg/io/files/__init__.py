"""What files look like, and how results come whole onto a disk."""
