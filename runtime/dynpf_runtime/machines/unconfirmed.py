"""Unconfirmed messages: what a node's host has said and the recorder does not have in its file yet, or others not read.

It is said again when somebody has come back, until the recorder confirms it: whoever was gone may have missed it. In
lockstep what all nodes have made the next tick after, all have read; the recorder confirms no more than that.
"""

from collections import deque
from collections.abc import Iterator

from dynpf_runtime.machines.effects import NEVER_NS, Put

__all__ = ["Unconfirmed"]

MOST_UNCONFIRMED = 48 * 2**20
"""How much a host keeps, bytes, before it waits for the recorder: less than one key may take of a recorder's queue."""

_FIRST_NS = 50_000_000
"""How long to wait after somebody has come back: others may be about to, and its subscriptions come after its token."""

_AGAIN_NS = 1_000_000_000
"""How long to wait then for the recorder's word before saying all again; each time twice as long."""


class Unconfirmed:
    """Messages by the ticks of their node, in the order in which they were said."""

    def __init__(self) -> None:
        self.bytes = 0
        self.wake_ns = NEVER_NS  # when to say them again
        self.urgent = False  # whether that is to come before anything new
        self._said: deque[tuple[int, Put]] = deque()
        self._wait_ns = 0
        self._until = 0  # ticks

    def add(self, tick: int, put: Put) -> None:
        """Keep a message that is said in a tick."""
        self._said.append((tick, put))
        self.bytes += len(put.payload)

    def full(self, ticks: int) -> bool:
        """Return whether no more is to be said after ``ticks`` ticks before the recorder has confirmed older ones.

        The last may have to wait for the next one: only then is it known that all have read it.
        """
        return self.bytes > MOST_UNCONFIRMED and self._said[0][0] < ticks - 1

    def confirm(self, ticks: int) -> None:
        """Forget what was said in the first ``ticks`` ticks: the recorder has them in its file; nobody lacks them."""
        said = self._said
        while said and said[0][0] < ticks:
            self.bytes -= len(said.popleft()[1].payload)
        if self.wake_ns != NEVER_NS and ticks >= self._until and not self.urgent:
            self.wake_ns = NEVER_NS

    def rouse(self, now_ns: int, ticks: int) -> None:
        """Say all again soon, because somebody has come back after ``ticks`` ticks of this node."""
        self.wake_ns, self.urgent = now_ns + _FIRST_NS, True
        self._wait_ns, self._until = _AGAIN_NS, ticks

    def again(self, now_ns: int) -> Iterator[Put]:
        """Yield all messages if it is time."""
        if now_ns < self.wake_ns:
            return
        self.urgent = False
        self.wake_ns, self._wait_ns = now_ns + self._wait_ns, 2 * self._wait_ns
        yield from (put for _, put in list(self._said))
