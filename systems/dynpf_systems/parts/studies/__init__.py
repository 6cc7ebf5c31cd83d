"""PARTS's experiments, and further ones."""
