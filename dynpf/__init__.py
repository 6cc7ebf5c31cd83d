"""The algorithms: NumPy in, NumPy out. Knows no bus, no file format, no clock and no global random state."""
