"""A run on the bus: one process per node, over Zenoh."""
