"""Progress of long work, told in one line of the terminal while a person is watching."""

import sys
import time

__all__ = ["Progress"]

PERIOD_S = 0.3
_CLEAR_LINE = "\r\x1b[K"


class Progress:
    """A line that is written over and over; nothing is written where stderr is no terminal."""

    def __init__(self) -> None:
        self._watched = sys.stderr.isatty()
        self._next = time.monotonic() + PERIOD_S

    def show(self, ticks: int, messages: int) -> None:
        now = time.monotonic()
        if self._watched and now >= self._next:
            self._next = now + PERIOD_S
            print(f"{_CLEAR_LINE}tick {ticks}, {messages} messages", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._watched:
            print(_CLEAR_LINE, end="", file=sys.stderr, flush=True)
