"""A stream of frames: a frame goes in, the posterior so far comes out."""
