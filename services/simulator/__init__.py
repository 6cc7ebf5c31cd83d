"""The simulator: the true world of a run, and its clock."""
