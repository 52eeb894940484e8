"""A look at a recording before a fit: what it shows, and what will hinder."""
