"""Scenarios: reading and checking them, their files and user code, and building plan and nodes from them."""
