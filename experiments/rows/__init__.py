"""Rows: one a trial, written as it ends, with where it comes from."""
