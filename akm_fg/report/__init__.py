"""From one run to a page and tables that a stranger can read."""
