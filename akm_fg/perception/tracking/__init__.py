"""Points followed through images and lifted into space."""
