"""Who hears whom, and rounds of messages."""
