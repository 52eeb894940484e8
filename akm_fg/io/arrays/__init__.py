"""Archives of arrays as trackers write them: read safely, and found out what is what."""
