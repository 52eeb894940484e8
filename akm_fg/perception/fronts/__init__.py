"""What one view tells of an object's fronts: planes, gaps between them, what sticks out."""
