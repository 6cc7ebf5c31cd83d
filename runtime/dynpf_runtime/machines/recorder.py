"""The recorder: a member of the run that receives everything and has it written, outside the lockstep loop."""

from collections import Counter
from collections.abc import Iterable, Iterator
from enum import Enum

import msgspec
from dynpf_formats.recording.header import RunEnd
from dynpf_protocol.codec import encode
from dynpf_protocol.control import Recorded, TickDone, decode_control, encode_control
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import BadMessageError, DynpfError, ProtocolError, RunError
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry
from dynpf_protocol.keys import DATA, JOURNAL, RECORDED, RECORDER, TICK
from dynpf_protocol.messages import Log, LogLevel, timestamp

from dynpf_runtime.machines.effects import (
    NEVER_NS,
    Close,
    Effect,
    Ended,
    Flush,
    Open,
    Put,
    Record,
    Show,
    Subscribe,
    Tell,
)
from dynpf_runtime.machines.events import Arrived, Closed, Event, Now, StopAsked, Woke
from dynpf_runtime.machines.intake import check_sender
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.plan import Plan

__all__ = ["SETTLE_NS", "RecorderMachine"]

FLUSH_NS = 50_000_000
SETTLE_NS = 3_000_000_000
"""How long the recorder waits, after the last step of every node, for messages that are still missing."""

SEE_OFF_NS = 2_000_000_000
"""How long the others may take to leave after the recorder has confirmed the run."""

_RUN = (DATA, JOURNAL, TICK)


class _Stage(Enum):
    ASSEMBLING = "until the run begins"
    RECORDING = "until every node has made its last step and all its messages have arrived"
    BROKEN = "until everything that had arrived when the run broke off is written"
    CLOSING = "until the file is closed"
    SEEING_OFF = "until the others have left"


class RecorderMachine:
    """Records one run of ``plan`` under one ``boot``. ``path`` and ``endpoint`` only appear in texts.

    If the run breaks off, it has everything that has arrived written, marks the recording as incomplete, and says so.
    """

    def __init__(self, plan: Plan, boot: str, endpoint: str, path: str) -> None:
        prepare: list[Effect] = [*(Subscribe(f"{prefix}**") for prefix in _RUN), Open()]
        self._member = Membership(RECORDER, plan, boot, endpoint, prepare, leads=False)
        self._boot = boot
        self._path = path
        self._graph = plan.graph
        self._nodes = plan.graph.nodes
        self._stage = _Stage.ASSEMBLING
        self._error: BaseException | None = None
        self._promised: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._steps: dict[str, int] = {}
        self._entries: Counter[str] = Counter()
        self._ticks: dict[str, int] = {}
        self._last: set[str] = set()
        self._outcome = ""
        self._refused: Counter[str] = Counter()
        self._early: list[Arrived] = []  # arrivals before the run begins, which come from strangers
        self._stamp_ns = 0
        self._due_ns = NEVER_NS  # deadline of the stage: for missing messages, or for the others to leave
        self._flush_at_ns = 0

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock at which Woke is due."""
        if self._stage is _Stage.BROKEN:
            return 0  # as soon as no arrival waits
        wake_ns = min(self._member.wake_ns, self._due_ns)
        return min(wake_ns, self._flush_at_ns) if self._stage is _Stage.RECORDING else wake_ns

    def handle(self, event: Event, now: Now) -> Iterable[Effect]:
        """Return the effects of an event."""
        if (
            self._stage is _Stage.RECORDING
            and len(self._last) < len(self._nodes)
            and type(event) is Arrived
            and event.key.startswith((DATA, JOURNAL))
            and now.monotonic_ns < self.wake_ns
        ):  # the most frequent case takes the shortest path
            return self._take(event, now)
        return self._caught(self._handle(event, now))

    def _caught(self, effects: Iterator[Effect]) -> Iterator[Effect]:
        try:
            yield from effects
        except (RunError, KeyboardInterrupt) as error:
            if self._member.joined and self._stage in (_Stage.ASSEMBLING, _Stage.RECORDING):
                self._stage, self._error = _Stage.BROKEN, error
            else:
                yield Ended(error)
        except DynpfError as error:
            yield Ended(error)

    def _handle(self, event: Event, now: Now) -> Iterator[Effect]:
        stage, member = self._stage, self._member
        if type(event) is Arrived and event.key.startswith(_RUN):
            if stage is _Stage.ASSEMBLING:
                self._early.append(event)
            elif stage in (_Stage.RECORDING, _Stage.BROKEN):
                yield from self._take(event, now)
            if now.monotonic_ns >= member.wake_ns and stage is not _Stage.BROKEN:
                yield from member.handle(event, now.monotonic_ns)
        elif type(event) is Closed:
            yield from self._confirm(event.end, now)
        elif stage is _Stage.BROKEN:
            if type(event) is Woke:
                self._stage = _Stage.CLOSING
                stopped = "stopped by the user" if self._steps else "stopped before the run began"
                yield Close(False, str(self._error) or stopped)
        elif stage is not _Stage.SEEING_OFF or type(event) is not StopAsked:
            yield from member.handle(event, now.monotonic_ns)
        if self._stage is _Stage.ASSEMBLING and member.running:
            yield from self._begin(now)
        if self._stage is _Stage.RECORDING:
            yield from self._record(now)
        elif self._stage is _Stage.SEEING_OFF and (not member.present or now.monotonic_ns >= self._due_ns):
            yield Ended(self._error)

    def _begin(self, now: Now) -> Iterator[Effect]:
        self._stage = _Stage.RECORDING
        for early in self._early:
            yield from self._take(early, now)
        self._early.clear()

    def _record(self, now: Now) -> Iterator[Effect]:
        """Close the recording when the run is complete, or when missing messages have not come in time."""
        if now.monotonic_ns >= self._flush_at_ns:
            self._flush_at_ns = now.monotonic_ns + FLUSH_NS
            yield Flush(now.monotonic_ns)
            yield Show(self._member.ticks, self._received.total())
        if len(self._last) < len(self._nodes):
            return
        self._member.leaving = True
        if not self._missing():
            self._stage = _Stage.CLOSING
            yield Close(True, self._member.stop_reason or "finished", self._outcome)
        elif self._due_ns == NEVER_NS:
            self._due_ns = now.monotonic_ns + SETTLE_NS
        elif now.monotonic_ns >= self._due_ns:
            self._stage = _Stage.CLOSING
            yield Close(False, self._lacking())

    def _confirm(self, end: RunEnd, now: Now) -> Iterator[Effect]:
        """Announce that the file is closed; after a complete run, wait until the others have left."""
        self._member.leaving = True
        recorded = Recorded(self._boot, end.complete, end.reason, self._path)
        yield Put(RECORDED, encode_control(recorded))
        if self._error is not None:
            yield Ended(self._error)
            return
        self._stage, self._due_ns = _Stage.SEEING_OFF, now.monotonic_ns + SEE_OFF_NS
        if not end.complete:
            self._error = RunError(f"{self._path} is incomplete: {end.reason}")

    def _take(self, arrived: Arrived, now: Now) -> Iterable[Effect]:
        try:
            if arrived.key.startswith(DATA):
                name, envelope = check_sender(arrived, self._member.boots, self._graph)
                self._received[name] += 1
                return (Record(name, envelope, arrived.payload),)
            if arrived.key.startswith(JOURNAL):
                return (self._journalled(arrived),)
            self._tick(decode_control(arrived.payload, TickDone))
        except ProtocolError as error:
            return self._refuse(arrived.key, str(error), now)
        return ()

    def _journalled(self, arrived: Arrived) -> Record:
        envelope = decode_envelope(arrived.attachment)
        if self._member.boots.get(envelope.node) != envelope.boot:
            raise ProtocolError(f"unknown sender {envelope.node!r} with boot {envelope.boot!r}")
        topic = JOURNAL_PREFIX + envelope.node
        try:
            entry = decode_entry(arrived.payload)
        except msgspec.DecodeError as error:
            raise BadMessageError(f"{topic}: {error}") from error
        self._entries[envelope.node] += 1
        return Record(topic, envelope, arrived.payload, entry)

    def _refuse(self, key: str, reason: str, now: Now) -> Iterator[Effect]:
        self._refused[key] += 1
        if self._refused[key] > 1:
            return
        text = f"{key}: message refused: {reason}"
        yield Tell(text)
        number, ticks = len(self._refused) - 1, self._member.ticks
        envelope = Envelope(RECORDER, self._boot, number, ticks, self._stamp_ns, now.wall_ns)
        message = Log(timestamp=timestamp(self._stamp_ns), level=LogLevel.WARNING, message=text, name=RECORDER)
        yield Record("log", envelope, encode("log", message))

    def _tick(self, done: TickDone) -> None:
        if self._member.boots.get(done.node) != done.boot:
            raise ProtocolError(f"unknown sender {done.node!r} with boot {done.boot!r}")
        self._promised.update(done.counts)
        self._steps[done.node] = done.step + 1
        self._ticks[done.node] = done.tick + 1
        self._stamp_ns = max(self._stamp_ns, done.stamp_ns)
        if done.last:
            self._last.add(done.node)
            self._outcome = done.outcome or self._outcome
        self._member.ticks = min(self._ticks.get(node, 0) for node in self._nodes)

    def _missing(self) -> dict[str, int]:
        missing = {topic: count - self._received[topic] for topic, count in self._promised.items()}
        missing |= {f"journal/{node}": steps - self._entries[node] for node, steps in self._steps.items()}
        return {topic: count for topic, count in missing.items() if count > 0}

    def _lacking(self) -> str:
        return "never arrived: " + ", ".join(f"{count} on {topic}" for topic, count in sorted(self._missing().items()))
