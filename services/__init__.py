"""The processes: one folder each, their hosts and runners, recordings, and the command line."""
