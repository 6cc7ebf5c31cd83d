"""The simulated worlds: true state and overhead camera. Each world is a pure node; the simulator is the source of the run."""
