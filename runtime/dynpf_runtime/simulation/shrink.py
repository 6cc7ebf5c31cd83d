"""Shrinking: the fewest faults that still break an invariant (Zeller and Hildebrandt, Simplifying and Isolating
Failure-Inducing Input, 2002)."""

from collections.abc import Callable, Sequence
from typing import TypeVar

__all__ = ["shrunk"]

_Item = TypeVar("_Item")


def shrunk(items: Sequence[_Item], fails: Callable[[Sequence[_Item]], bool]) -> tuple[_Item, ...]:
    """Return as few of ``items``, in their order, as still fail: no single one of them can be left out.

    ``items`` as a whole have to fail.
    """
    kept = tuple(items)
    pieces = 2
    while kept:
        size = max(1, len(kept) // pieces)
        for start in range(0, len(kept), size):
            fewer = kept[:start] + kept[start + size :]
            if fails(fewer):
                kept, pieces = fewer, 2
                break
        else:
            if size == 1:
                break
            pieces *= 2
    return kept
