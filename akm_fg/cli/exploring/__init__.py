"""`akm-fg explore` and its parts."""
