"""`akm-fg run`: take a part of a simulated object to a target, exploring it before if need be."""
