"""Scenarios: what a file says, its files and code, and the plan and nodes that are made of it."""
