"""The recorder: writes every message and the journal of every node into one MCAP file."""
