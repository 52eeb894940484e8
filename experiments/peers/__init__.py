"""Published estimators that run as their authors released them, in environments of their own."""
