"""PARTS's experiments, and some that it does not have."""
