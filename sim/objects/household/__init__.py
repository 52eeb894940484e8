"""Household things that open: suites of boxes, laptops, bins, washers and the like."""
