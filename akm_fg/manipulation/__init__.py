"""Takes a part of a known model from any state to a target, and says how sure it is of the end."""
