"""The router: the hub that every other process of a run is a client of."""
