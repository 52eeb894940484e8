"""Grasp samplers."""
