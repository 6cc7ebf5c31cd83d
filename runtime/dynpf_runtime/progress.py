"""The progress of a run, shown in one line of the terminal."""

import sys
import time

__all__ = ["Progress"]

PERIOD_S = 0.3
_CLEAR_LINE = "\r\x1b[K"


class Progress:
    """A line that is overwritten at each update; nothing is written if stderr is no terminal."""

    def __init__(self) -> None:
        self._visible = sys.stderr.isatty()
        self._next = time.monotonic() + PERIOD_S

    def show(self, ticks: int, messages: int) -> None:
        """Update the line, unless that was done a moment ago."""
        now = time.monotonic()
        if self._visible and now >= self._next:
            self._next = now + PERIOD_S
            print(f"{_CLEAR_LINE}tick {ticks}, {messages} messages", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Erase the line."""
        if self._visible:
            print(_CLEAR_LINE, end="", file=sys.stderr, flush=True)
