"""Progress of long work, shown in one line of the terminal, with the time that is left."""

import sys
import time
from collections.abc import Callable

__all__ = ["Progress", "Share", "show_progress", "time_left"]

PERIOD_S = 0.3
TOLD_AFTER_S = 2.0
"""How long work has to last before the time that is left is told: what takes less is over before one has read it."""

_CLEAR_LINE = "\r\x1b[K"

Clock = Callable[[], float]


def show_progress(text: str) -> None:
    """Replace the line by ``text``, or erase it if that is empty; do nothing if stderr is no terminal."""
    if sys.stderr.isatty():
        print(f"{_CLEAR_LINE}{text}", end="", file=sys.stderr, flush=True)


def time_left(done: float, total: float, spent_s: float) -> str:
    """Return the end of a sentence: the time that the rest takes at the pace so far; "" in the first seconds."""
    if spent_s < TOLD_AFTER_S or not 0.0 < done < total:
        return ""
    left_s = spent_s * (total - done) / done
    if left_s < 90.0:
        return f", {left_s:.0f} s left"
    return f", {left_s / 60.0:.0f} min left" if left_s < 5400.0 else f", {left_s / 3600.0:.1f} h left"


class Share:
    """The progress of work of known size: a line that is updated a few times a second, from a moment after the start.

    ``what`` are the words after the numbers. As a context, it erases its line at the end.
    """

    def __init__(self, total: int, what: str, clock: Clock = time.monotonic) -> None:
        self._total, self._what, self._clock = total, what, clock
        self._began = clock()
        self._next = self._began + PERIOD_S

    def __enter__(self) -> "Share":
        return self

    def __exit__(self, *_: object) -> None:
        show_progress("")

    def show(self, done: int, more: str = "") -> None:
        """Update the line, unless that was done a moment ago; ``more`` are further words."""
        now = self._clock()
        if now >= self._next:
            self._next = now + PERIOD_S
            left = time_left(done, self._total, now - self._began)
            show_progress(f"{done} of {self._total} {self._what}{more}{left}")


class Progress:
    """The progress of a run of at most ``most`` ticks; the time left is that to the last of them."""

    def __init__(self, most: int, clock: Clock = time.monotonic) -> None:
        self._share = Share(most, "ticks at most", clock)

    def show(self, ticks: int, messages: int, *, paused: bool = False) -> None:
        """Update the line, unless that was done a moment ago."""
        self._share.show(ticks, f", {messages} messages{', paused' if paused else ''}")

    def clear(self) -> None:
        """Erase the line."""
        show_progress("")
