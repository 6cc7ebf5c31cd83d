"""Recursive Bayesian filters and the pieces they share: pure functions of arrays, one scheme a module."""
