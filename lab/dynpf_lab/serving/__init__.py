"""Files of a run served on loopback, for viewers that run in a browser."""
