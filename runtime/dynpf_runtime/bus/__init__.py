"""A run on the bus: one process a node, over Zenoh."""
