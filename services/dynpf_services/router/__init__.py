"""The router: the hub of a run; every other process is its client."""
