"""Experiments: runs in this process, what they are worth, and studies of many of them; it knows no system."""
