"""Turns: when a node's next step is due, in lockstep and realtime, for the source of a run and for the other nodes."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple, Protocol

from dynpf_protocol.errors import RunError
from dynpf_protocol.messages import HostEvent

from dynpf_runtime.executor import Sent
from dynpf_runtime.inbox import LockstepInbox, Ready, RealtimeInbox
from dynpf_runtime.machines.effects import NEVER_NS
from dynpf_runtime.plan import Plan
from dynpf_runtime.source import Feed, LiveFeeds, LiveSource, LogRecord, feed_log, feed_ticks

__all__ = [
    "Beginning",
    "FollowLockstep",
    "FollowRealtime",
    "LeadLive",
    "LeadLockstep",
    "LeadRealtime",
    "Turn",
    "Turns",
    "turns_of",
]


class Turn(NamedTuple):
    """The inputs and the logical time of a step that is due, and the log's records that the source publishes in it."""

    ready: Ready
    stamp_ns: int
    last: bool
    fed: tuple[Sent, ...] = ()
    gaps: tuple[HostEvent, ...] = ()  # of a live robot's records


class Beginning(NamedTuple):
    """How many ticks have been before, when the last was, and the next numbers of a live robot's records."""

    ticks: int = 0
    stamp_ns: int = 0
    numbers: Mapping[str, int] = {}


class Turns(Protocol):
    """Decides when a node steps next."""

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock to ask again even if nothing has arrived."""

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:
        """Return the next step's turn if it is due, else None.

        ``idle``: no arrival waits to be handled; ``stopping``: the source's next tick is to be the last; ``held``: the
        node must not make another step yet.
        """

    def pace(self, rate: float | None) -> None:
        """Go on at another rate of logical to wall-clock time; only the source has one."""


class FollowLockstep:
    """Steps when all messages of a tick have arrived."""

    wake_ns = NEVER_NS

    def __init__(self, inbox: LockstepInbox) -> None:
        self._inbox = inbox

    def take(self, _now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        """Return the turn if the inputs are complete."""
        return None if held else self.repeat(stopping=stopping)

    def repeat(self, *, stopping: bool) -> Turn | None:  # noqa: ARG002
        """Return the turn if the inputs are complete."""
        ready = self._inbox.take()
        return None if ready is None else Turn(ready, ready.stamp_ns, ready.last)

    def pace(self, rate: float | None) -> None:
        """Do nothing: it follows."""


class FollowRealtime:
    """Steps when a message triggers it, on all messages that have arrived."""

    def __init__(self, inbox: RealtimeInbox) -> None:
        self._inbox = inbox
        self._held = False

    @property
    def wake_ns(self) -> int:
        """The time of the next delayed message's arrival, unless something else has to come first."""
        due_ns = self._inbox.due_ns()
        return NEVER_NS if due_ns is None or self._held else due_ns

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        """Return the turn if a message triggers it, or at the end of the run."""
        self._held = held
        if held:
            return None
        inbox = self._inbox
        ready = inbox.take_all(now_ns) if inbox.upstream_ended else inbox.take(now_ns)
        return None if ready is None else Turn(ready, ready.stamp_ns, ready.last)

    def pace(self, rate: float | None) -> None:
        """Do nothing: it follows."""


class _Paced:
    """The feeds of a source, and the time on the monotonic clock at which each tick begins; without a rate, at once."""

    def __init__(self, feeds: Iterator[Feed], rate: float | None) -> None:
        self._feeds = feeds
        self._rate = rate
        self._began_ns: int | None = None
        self._first_ns = 0
        self._feed: Feed | None = None

    def feed(self) -> Feed:
        """Return the next feed; raises RunError if no record begins a tick."""
        if self._feed is None:
            self._feed = next(self._feeds, None)
        if self._feed is None:
            raise RunError("the log has no record that a node of this run reads: no tick begins")
        return self._feed

    def next(self, now_ns: int) -> tuple[Feed, int]:
        """Return the next feed and when it is due; the first one is due now."""
        feed = self.feed()
        if self._began_ns is None:
            self._began_ns, self._first_ns = now_ns, feed.stamp_ns
        past_ns = 0 if self._rate is None else round((feed.stamp_ns - self._first_ns) / self._rate)
        return feed, self._began_ns + past_ns

    def pace(self, rate: float | None) -> None:
        """Go on at another rate, from now on: the next feed is due at once."""
        self._rate, self._began_ns = rate, None

    def begin(self, ready: Ready, *, stopping: bool) -> Turn:
        """Return the turn of the current feed, and advance to the next one."""
        feed, self._feed = self._feed, None
        assert feed is not None
        ready.inputs[:0] = feed.inputs
        return Turn(ready, feed.stamp_ns, feed.last or stopping, feed.sent)


class LeadLockstep:
    """Begins a tick when all nodes have ended the previous one, and not before its time if the run has a rate.

    ``alone`` says that there are no other nodes whose messages would wake it.
    """

    def __init__(self, inbox: LockstepInbox, feeds: Iterator[Feed], rate: float | None, *, alone: bool) -> None:
        self._inbox = inbox
        self._alone = alone
        self._woken = rate is None and not alone
        self._paced = _Paced(feeds, rate)
        self._ready: Ready | None = None
        self.wake_ns = 0

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        """Return the turn of the next tick if it is due and all nodes have ended the previous one."""
        feed, due_ns = self._paced.next(now_ns)
        if due_ns > now_ns and not stopping:
            self.wake_ns = due_ns
            return None
        self.wake_ns = NEVER_NS
        if self._ready is None:
            self._ready = self._inbox.take(feed.stamp_ns)
        if self._ready is None or held:
            return None
        self.wake_ns = NEVER_NS if self._woken else 0
        return self.repeat(stopping=stopping)

    def repeat(self, *, stopping: bool) -> Turn | None:
        """Return the turn of the next tick if all nodes have ended the previous one, whatever the time."""
        ready, self._ready = self._ready, None
        if ready is None:
            ready = self._inbox.take(self._paced.feed().stamp_ns)
        return None if ready is None else self._paced.begin(ready, stopping=stopping)

    def pace(self, rate: float | None) -> None:
        """Go on at another rate."""
        self._paced.pace(rate)
        self._woken = rate is None and not self._alone
        self.wake_ns = 0


class LeadRealtime:
    """Begins a tick by the wall clock, on all messages that have arrived."""

    def __init__(self, inbox: RealtimeInbox, feeds: Iterator[Feed], rate: float) -> None:
        self._inbox = inbox
        self._paced = _Paced(feeds, rate)
        self.wake_ns = 0

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:
        """Return the turn of the next tick if its time has come and no arrival waits."""
        if held:
            self.wake_ns = NEVER_NS
            return None
        _, self.wake_ns = self._paced.next(now_ns)
        if now_ns < self.wake_ns or not idle:
            return None
        self.wake_ns = 0  # the next tick may be late already
        return self._paced.begin(self._inbox.take_all(now_ns), stopping=stopping)

    def pace(self, rate: float | None) -> None:
        """Go on at another rate, 1 without one."""
        self._paced.pace(rate or 1.0)
        self.wake_ns = 0


class LeadLive:
    """Begins a tick whenever a live robot's record has arrived that begins one, on all messages that are here."""

    def __init__(self, inbox: RealtimeInbox, feeds: LiveFeeds, publish_ns: int) -> None:
        self._inbox = inbox
        self._feeds = feeds
        self._ahead_ns: int | None = None  # of the wall clock to the monotonic one
        self._publish_ns = publish_ns
        self._held = False

    @property
    def wake_ns(self) -> int:
        """At once if something has arrived from the robot."""
        return 0 if self._feeds.waiting and not self._held else NEVER_NS

    def take(self, now_ns: int, *, idle: bool, stopping: bool, held: bool) -> Turn | None:  # noqa: ARG002
        """Return the turn of the next tick if a record begins one, or if it is to be the last."""
        if self._ahead_ns is None:
            self._ahead_ns = self._publish_ns - now_ns
        self._held = held
        if held:
            return None
        feed = self._feeds.next(now_ns + self._ahead_ns, stopping=stopping)
        if feed is None:
            return None
        ready = self._inbox.take_all(now_ns)
        ready.inputs[:0] = feed.inputs
        return Turn(ready, feed.stamp_ns, feed.last, feed.sent, feed.gaps)

    def pace(self, rate: float | None) -> None:
        """Do nothing: the robot sets it."""


def turns_of(
    plan: Plan,
    inbox: LockstepInbox | RealtimeInbox,
    boot: str | None,
    begins: Beginning,
    *,
    log: Sequence[LogRecord],
    live: LiveSource | None,
    wall_ns: int,
) -> Turns:
    """Return when a node steps, from where it ``begins``. ``boot`` is that of the run's source, None for others.

    The source takes the records of ``log`` if the run plays one, or those of ``live``.
    """
    if boot is None:
        return FollowLockstep(inbox) if isinstance(inbox, LockstepInbox) else FollowRealtime(inbox)
    if live is not None and isinstance(inbox, RealtimeInbox):
        ticks, stamp_ns, numbers = begins
        feeds = LiveFeeds(live, plan.graph, boot=boot, max_ticks=plan.max_ticks)
        feeds.go_on(ticks, stamp_ns, numbers)
        return LeadLive(inbox, feeds, wall_ns)
    paced = feed_ticks(plan.tick_ns, plan.max_ticks)
    if plan.plays_log:
        paced = feed_log(log, plan.graph, boot=boot, publish_ns=wall_ns, max_ticks=plan.max_ticks)
    paced = islice(paced, begins.ticks, None)
    if isinstance(inbox, LockstepInbox):
        return LeadLockstep(inbox, paced, plan.rate, alone=len(plan.graph.nodes) == 1)
    return LeadRealtime(inbox, paced, plan.rate or 1.0)
