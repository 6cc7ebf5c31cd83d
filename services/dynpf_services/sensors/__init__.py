"""Sensors as objects, and the two nodes that have any number of them: one reads the truth, one plays a log."""
