"""The terminal: notices for the user, and the signals by which the user ends a process."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from dynpf_protocol.printable import printable

__all__ = ["StopSignal", "say"]

_MOST_CHARACTERS = 2000


def say(name: str, text: str) -> None:
    """Print a notice for the user, without control characters: it may hold text from the bus."""
    line = printable(f"dynpf {name}: {text}", _MOST_CHARACTERS)
    sys.stderr.write(f"{line}\n")  # in one piece: other processes write there, too
    sys.stderr.flush()


class StopSignal:
    """Ctrl-C or a termination signal: the first asks the run to end cleanly, the second ends this process at once.

    The end of ``parent``, the process that started this one and would have stopped it, counts as such a signal.
    """

    def __init__(self, parent: int | None = None) -> None:
        self._parent = parent
        self._requested = False
        self.at_once = False
        self.reason = ""
        self._wake: Callable[[], None] | None = None

    @property
    def requested(self) -> bool:
        """Whether the process is to end."""
        if self._parent is not None and not self._requested and os.getppid() != self._parent:
            self.request("dynpf run, which had started it, was killed")
        return self._requested

    def request(self, reason: str) -> None:
        """Ask the process to end, when called again, at once."""
        self.at_once = self._requested
        self._requested = True
        self.reason = self.reason or reason
        if self._wake is not None:
            self._wake()

    def wakes(self, wake: Callable[[], None]) -> None:
        """Call ``wake`` at every request, possibly from a signal handler."""
        self._wake = wake

    @classmethod
    @contextmanager
    def installed(cls, parent: int | None = None) -> Iterator["StopSignal"]:
        """Catch SIGINT and SIGTERM while the block runs."""
        stop = cls(parent)

        def handle(_number: int, _frame: FrameType | None) -> None:
            stop.request("stopped by the user")

        before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield stop
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
