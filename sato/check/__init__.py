"""Checking of a run: promises that are recomputed, and the report of them."""
