"""Readers and writers of every file format. Formats: docs/conventions.md."""
