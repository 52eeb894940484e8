"""Objects of which several parts open: what is done with one before the next is looked for."""
