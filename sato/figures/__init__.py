"""Parts that the figures of all systems share."""
