"""What an update costs: ours, plain NumPy's and other libraries', measured in turns."""
