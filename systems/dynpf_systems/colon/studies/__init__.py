"""COLON's experiments."""
