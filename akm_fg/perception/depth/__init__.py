"""Depth images: their noise, edges and planes, and the object in them."""
