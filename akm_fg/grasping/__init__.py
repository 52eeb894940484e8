"""Grasps: poses of the hand from what a camera sees around a contact."""
