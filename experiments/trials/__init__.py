"""What a trial is made of: openings, cells, methods, the bound."""
