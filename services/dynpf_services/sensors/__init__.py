"""Sensor kinds, and the two nodes that have any number of them: one simulates sensors, one plays a log."""
