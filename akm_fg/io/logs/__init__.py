"""Pose logs as people have them: rows of text, what the columns are, and whether it can be so."""
