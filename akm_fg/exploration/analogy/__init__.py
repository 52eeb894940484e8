"""Where to take hold, by analogy: what opened before looked like this (the paper's Eq. 1)."""
