"""Schema version: raised whenever old recordings can no longer be read with their meaning."""

__all__ = ["READABLE_VERSIONS", "SCHEMA_VERSION"]

SCHEMA_VERSION = 3
"""The version that this protocol writes."""

READABLE_VERSIONS = (3,)
"""The versions that this protocol reads; others are refused, naming the version of dynpf that wrote them."""
