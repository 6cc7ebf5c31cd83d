"""A fuzzer of whatever reads files and payloads: hostile input is refused in a sentence or read, within bounds.

``python -m checks.fuzz`` is the long form; tests/unit/fuzz runs a short one.
"""
