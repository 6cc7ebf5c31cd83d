"""Keys: which of them a subscription's pattern matches."""

from collections.abc import Iterable
from functools import cache

__all__ = ["first_match", "matches"]


def first_match(patterns: Iterable[str], key: str) -> str | None:
    """Return the first pattern that matches a key."""
    return next((pattern for pattern in patterns if matches(pattern, key)), None)


@cache
def matches(pattern: str, key: str) -> bool:
    """Return whether ``key`` matches ``pattern``, in which ``*`` is one part and ``**`` any number of parts."""
    return _match(pattern.split("/"), key.split("/"))


def _match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_match(pattern[1:], key[skipped:]) for skipped in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _match(pattern[1:], key[1:])
