"""Check of a reconfiguration: promises and summary, recomputed from the recorded data."""
