"""Check of a formation flight: recompute what it promises and what its summary says."""
