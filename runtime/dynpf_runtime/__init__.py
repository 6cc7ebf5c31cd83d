"""The runtime: nodes, and the runners that execute them: over the bus, in one process, and from a recording."""
