"""From rows to tables and figures of the docs."""
