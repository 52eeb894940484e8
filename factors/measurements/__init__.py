"""Factors of what is measured: tracks, surfaces, orientations, grasps, boards."""
