"""The command line: the one place that prints, and that puts all rooms together."""
