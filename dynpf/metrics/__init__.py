"""Measures of a run, from arrays of what was true and what was estimated."""
