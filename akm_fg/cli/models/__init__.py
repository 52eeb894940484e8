"""Commands on models of objects."""
