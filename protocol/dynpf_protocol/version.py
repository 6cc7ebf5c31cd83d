"""Schema version: raised whenever an old recording could no longer be read as what it meant."""

__all__ = ["READABLE_VERSIONS", "SCHEMA_VERSION"]

SCHEMA_VERSION = 2
"""What this protocol writes."""

READABLE_VERSIONS = (2,)
"""What this protocol still reads; any other is refused, naming the version of dynpf that wrote it."""
