"""The pulse of a process: what its main loop does, and since when, in memory that the starting process may look at."""

import mmap
import time
from pathlib import Path
from typing import NamedTuple, Self

from dynpf_protocol.control import Doing

__all__ = ["Pulse", "Reading"]


class Reading(NamedTuple):
    """A pulse at one moment."""

    doing: Doing
    since_ns: int  # on the system's monotonic clock
    tick: int  # of the last step begun
    turns: int  # how many events the loop has handled


_TURNING = int(Doing.TURNING)
_WORDS = 4
_BYTES = 8 * _WORDS


class Pulse:
    """Four machine words, written by the main loop alone and readable at any time, by other processes too."""

    def __init__(self, memory: mmap.mmap | bytearray) -> None:
        self._words = memoryview(memory).cast("Q")

    @classmethod
    def private(cls) -> Self:
        """Return a pulse that only this process sees."""
        return cls(bytearray(_BYTES))

    @classmethod
    def shared(cls, path: Path) -> Self:
        """Return the pulse in the file ``path``, which is made if it does not exist."""
        path.touch()
        with path.open("r+b") as file:
            file.truncate(_BYTES)
            return cls(mmap.mmap(file.fileno(), _BYTES))

    def now(self, doing: Doing) -> None:
        """Note what the main loop begins to do."""
        words = self._words
        words[1] = time.monotonic_ns()
        words[0] = doing

    def turn(self, now_ns: int) -> None:
        """Note that the loop handles its next event."""
        words = self._words
        words[1] = now_ns
        words[0] = _TURNING
        words[3] += 1

    def step(self, tick: int) -> None:
        """Note that a node's step begins."""
        self._words[2] = tick
        self.now(Doing.STEP)

    def read(self) -> Reading:
        """Return what the main loop does now."""
        doing, since_ns, tick, turns = self._words
        return Reading(Doing(doing), since_ns, tick, turns)
