"""From answers and truth to numbers and intervals."""
