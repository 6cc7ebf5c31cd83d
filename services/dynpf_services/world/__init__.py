"""What processes share of the world that they run in."""
