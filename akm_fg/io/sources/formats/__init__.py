"""One file a format: `NAME`, `recognises(path)` and `open_source(path, options)`."""
