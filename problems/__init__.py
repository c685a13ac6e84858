"""What to decide, once. Knows no swarm."""
