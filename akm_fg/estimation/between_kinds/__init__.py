"""Between the kinds: which are worth it, how probable each is."""
