"""Where a part of a known model is: a recursive filter over its joint's state."""
