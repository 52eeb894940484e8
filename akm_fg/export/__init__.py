"""Models for others: robot descriptions, meshes and messages."""
