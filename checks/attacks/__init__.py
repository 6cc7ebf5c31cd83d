"""Attacks on a run by a stranger on its bus: `python -m checks.attacks` tries all of them on real runs.

What a stranger does is a table (`kinds`), as functions of what it has heard (`spy`). The same table attacks simulated
runs in the tests; here each attack has a run of its own processes, and afterwards it is asked what became of it.
"""
