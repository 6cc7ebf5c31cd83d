"""Runs with a planted cause of failure, of which ``dynpf why`` has to name the cause and the tick.

``python -m checks.why`` asks why of each of them and prints what was found.
"""
