"""Where depth changed, and what motion that shows."""
