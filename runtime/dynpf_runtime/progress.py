"""Progress of long work, shown in one line of the terminal."""

import sys
import time

__all__ = ["Progress", "show_progress"]

PERIOD_S = 0.3
_CLEAR_LINE = "\r\x1b[K"


def show_progress(text: str) -> None:
    """Replace the line by ``text``, or erase it if that is empty; do nothing if stderr is no terminal."""
    if sys.stderr.isatty():
        print(f"{_CLEAR_LINE}{text}", end="", file=sys.stderr, flush=True)


class Progress:
    """The progress of a run: a line that is updated a few times a second."""

    def __init__(self) -> None:
        self._next = time.monotonic() + PERIOD_S

    def show(self, ticks: int, messages: int, before: str = "") -> None:
        """Update the line, unless that was done a moment ago; ``before`` stands before it."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + PERIOD_S
            show_progress(f"{before}tick {ticks}, {messages} messages")

    def clear(self) -> None:
        """Erase the line."""
        show_progress("")
