"""The simulated worlds: pure nodes that hold the true state; the simulator is the source of its run."""
