"""Recordings: one MCAP file a run. Writing, checked reading, content digest, comparison, diagnosis and recovery."""
