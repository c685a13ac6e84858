"""Check of a connectivity run: promises, recomputed from its data, and its summary."""
