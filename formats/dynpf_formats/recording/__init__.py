"""Recordings, one MCAP file per run: writing, checked reading, content digest, comparison, diagnosis and recovery."""
