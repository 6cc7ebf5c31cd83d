"""The runtime: nodes, and the ways to drive the same ones: over the bus, in one process, and from a recording."""
