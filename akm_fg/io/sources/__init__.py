"""Recordings in other people's formats: one file a format, one way from there to a `Recording`."""
