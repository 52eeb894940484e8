"""Objects from a user's own files: PartNet-Mobility folders and URDF files."""
