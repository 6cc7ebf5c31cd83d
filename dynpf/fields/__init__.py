"""Potential fields of parts rearrangement: what the robot descends, how fast, and what it must not touch."""
