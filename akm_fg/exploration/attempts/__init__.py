"""One try at a contact: held, pulled in stretches, watched, and what came of it."""
