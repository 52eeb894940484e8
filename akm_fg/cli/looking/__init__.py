"""Commands that look at a recording before a fit, and at an answer after it."""
