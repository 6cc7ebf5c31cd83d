"""Turns: when a node's next step is due, in either clock, for the source of a run and for those that follow it."""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from dynpf_protocol.errors import RunError

from dynpf_runtime.executor import Sent
from dynpf_runtime.inbox import LockstepInbox, Ready, RealtimeInbox
from dynpf_runtime.machines.effects import NEVER_NS
from dynpf_runtime.source import Feed

__all__ = ["FollowLockstep", "FollowRealtime", "LeadLockstep", "LeadRealtime", "Turn", "Turns"]


class Turn(NamedTuple):
    """The inputs and the logical time of a step that is due, and the records of a log that it feeds in."""

    ready: Ready
    stamp_ns: int
    last: bool
    fed: tuple[Sent, ...] = ()


class Turns(Protocol):
    """Says when a node steps next."""

    @property
    def wake_ns(self) -> int:
        """When on the monotonic clock to ask again though nothing has arrived."""

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:
        """Return the next step's turn if it is due.

        ``idle`` says that nothing waits to be received; ``stopping`` that the source's next tick shall be the last;
        ``held`` that the source shall not begin another tick yet.
        """


class FollowLockstep:
    """Steps when all that a tick promises has come."""

    wake_ns = NEVER_NS

    def __init__(self, inbox: LockstepInbox) -> None:
        self._inbox = inbox

    def take(self, _now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        ready = self._inbox.take()
        return None if ready is None else Turn(ready, ready.stamp_ns, ready.last)


class FollowRealtime:
    """Steps when a message triggers it, on whatever is there."""

    def __init__(self, inbox: RealtimeInbox) -> None:
        self._inbox = inbox

    @property
    def wake_ns(self) -> int:
        due_ns = self._inbox.due_ns()
        return NEVER_NS if due_ns is None else due_ns

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        inbox = self._inbox
        ready = inbox.take_all(now_ns) if inbox.upstream_ended else inbox.take(now_ns)
        return None if ready is None else Turn(ready, ready.stamp_ns, ready.last)


class _Paced:
    """The feeds of a source, and when on the monotonic clock each tick shall begin; without a rate, at once."""

    def __init__(self, feeds: Iterator[Feed], rate: float | None) -> None:
        self._feeds = feeds
        self._rate = rate
        self._began_ns: int | None = None
        self._first_ns = 0
        self._feed: Feed | None = None
        self._due_ns = 0

    def next(self, now_ns: int) -> tuple[Feed, int]:
        """Return the feed that is to come, and when it is due; raises RunError if nothing begins a tick."""
        if self._feed is None:
            feed = next(self._feeds, None)
            if feed is None:
                raise RunError("the log has no record that a node of this run reads: no tick begins")
            if self._began_ns is None:
                self._began_ns, self._first_ns = now_ns, feed.stamp_ns
            past_ns = 0 if self._rate is None else round((feed.stamp_ns - self._first_ns) / self._rate)
            self._feed, self._due_ns = feed, self._began_ns + past_ns
        return self._feed, self._due_ns

    def begin(self, ready: Ready, *, stopping: bool) -> Turn:
        """Return the turn of the feed that has come; the one after it is next."""
        feed, self._feed = self._feed, None
        assert feed is not None
        ready.inputs[:0] = feed.inputs
        return Turn(ready, feed.stamp_ns, feed.last or stopping, feed.sent)


class LeadLockstep:
    """Begins a tick when all have ended the one before, at its own time if the run has a rate.

    ``alone`` says that there are no others, by whose messages it would be woken.
    """

    def __init__(self, inbox: LockstepInbox, feeds: Iterator[Feed], rate: float | None, *, alone: bool) -> None:
        self._inbox = inbox
        self._woken = rate is None and not alone
        self._paced = _Paced(feeds, rate)
        self._ready: Ready | None = None
        self.wake_ns = 0

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        feed, due_ns = self._paced.next(now_ns)
        if due_ns > now_ns and not stopping:
            self.wake_ns = due_ns
            return None
        self.wake_ns = NEVER_NS
        if self._ready is None:
            self._ready = self._inbox.take(feed.stamp_ns)
        if self._ready is None or held:
            return None
        ready, self._ready = self._ready, None
        self.wake_ns = NEVER_NS if self._woken else 0
        return self._paced.begin(ready, stopping=stopping)


class LeadRealtime:
    """Begins a tick by the wall clock, on whatever has arrived."""

    def __init__(self, inbox: RealtimeInbox, feeds: Iterator[Feed], rate: float) -> None:
        self._inbox = inbox
        self._paced = _Paced(feeds, rate)
        self.wake_ns = 0

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        _, self.wake_ns = self._paced.next(now_ns)
        if now_ns < self.wake_ns or not idle:
            return None
        self.wake_ns = 0  # the next tick may be late already
        return self._paced.begin(self._inbox.take_all(now_ns), stopping=stopping)
