"""What `akm-fg fit` shows while it works, and what it leaves in a folder."""
