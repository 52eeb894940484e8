"""The moving part's surface in keyframes."""
