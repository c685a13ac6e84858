"""Communication graphs, synchronous rounds of messages, and the load of a radio link."""
