"""The simulator: the true world, its camera, and the run's clock."""
