"""Rigid motions and joints of points in space: what perception and estimation share."""
