"""The three ways to drive the same nodes: over the bus, inline in one process, and from a recording."""
