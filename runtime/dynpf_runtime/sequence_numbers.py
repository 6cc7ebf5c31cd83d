"""Sequence numbers: which of them have come, where some may be lost."""

from collections.abc import Iterable

from dynpf_protocol.errors import OrderError, RepeatError

__all__ = ["SeenNumbers"]

_LEAD = 1000
"""How far a number may be ahead of the last one, where some in between may have been lost."""


class SeenNumbers:
    """The numbers of a sequence that have come, of which some may be lost.

    A number that is ahead does not close those before it: if it was a stranger's, the true ones still count.
    """

    def __init__(self) -> None:
        self._next = 0
        self._open: set[int] = set()  # before _next, and yet to come
        self._leaps = False  # whether the next number may be any

    @classmethod
    def leaping(cls) -> "SeenNumbers":
        """Return an instance of which no number has come, and whose first may be any."""
        numbers = cls()
        numbers.leap()
        return numbers

    @property
    def following(self) -> int:
        """The number after the greatest that has come."""
        return self._next

    def came(self, number: int) -> bool:
        """Return whether a number has come before."""
        return number < self._next and number not in self._open

    def take(self, number: int) -> None:
        """Note a number; raises OrderError for one that has come before, or is far ahead of the last."""
        if number >= self._next + _LEAD and not self._leaps:
            raise OrderError(f"number {number}; expected {self._next}, or a little later")
        if number >= self._next:
            self._open.update(range(max(self._next, number - _LEAD), number))
            self._next, self._leaps = number + 1, False
            if len(self._open) > 2 * _LEAD:
                self._open = {lost for lost in self._open if lost >= number - _LEAD}
        elif number in self._open:
            self._open.discard(number)
        else:
            raise RepeatError(f"number {number} again; expected {self._next} or later")

    def leap(self) -> None:
        """Let the next number be any: whoever gives them, or takes them, was away."""
        self._leaps = True

    def close(self, number: int) -> None:
        """Note that a number and all before it have come, or never will."""
        if number >= self._next:
            self._next = number + 1
            self._open.clear()

    def freeze(self) -> tuple[int, tuple[int, ...]]:
        """Return the next number, and those before it that are yet to come."""
        return self._next, tuple(sorted(self._open))

    def thaw(self, following: int, lost: Iterable[int]) -> None:
        """Restore what ``freeze`` returned."""
        self._next, self._open = following, set(lost)
