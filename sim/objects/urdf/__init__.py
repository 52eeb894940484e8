"""URDF files: read, checked and written."""
