"""Benchmarks of updates: ours, plain NumPy's and other libraries', measured in turns."""
