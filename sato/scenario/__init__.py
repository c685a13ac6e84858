"""Scenarios: definitions of missions, from Python and from files. Knows no system."""
