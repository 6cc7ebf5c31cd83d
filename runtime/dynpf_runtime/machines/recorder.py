"""The recorder: a member of the run that receives everything and has it written, outside the lockstep loop."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum

from dynpf_formats.recording.header import RunEnd
from dynpf_protocol.codec import encode
from dynpf_protocol.control import Recorded
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import DynpfError, OrderError, ProtocolError, RepeatError, RunError
from dynpf_protocol.keys import AGAIN, DATA, JOURNAL, RECALL, RECORDER, RUN
from dynpf_protocol.messages import Log, LogLevel, Restart, timestamp
from dynpf_protocol.printable import printable

from dynpf_runtime.machines.effects import (
    NEVER_NS,
    Close,
    Effect,
    Ended,
    Flush,
    Open,
    Record,
    Show,
    Subscribe,
    Tell,
)
from dynpf_runtime.machines.events import (
    Arrived,
    Closed,
    Dropped,
    Event,
    Flushed,
    Found,
    Now,
    Started,
    StopAsked,
    Token,
    Woke,
)
from dynpf_runtime.machines.last_word import LastWord
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.rebuilding import rebuilt
from dynpf_runtime.machines.recalling import Recalling
from dynpf_runtime.machines.restarts import Restarts
from dynpf_runtime.machines.roles import Roles
from dynpf_runtime.machines.standstill import Standstill
from dynpf_runtime.plan import Plan

__all__ = ["SETTLE_NS", "RecorderMachine"]

FLUSH_NS = 50_000_000
SETTLE_NS = 3_000_000_000
"""How long the recorder waits for messages that are still missing after their senders say to have sent them."""

LATE_NS = 20_000_000_000
"""How long it waits, after the last end of a tick, for a sender that does not say so: a busy machine may hold it up."""

AGAIN_NS = 10_000_000_000
"""SETTLE_NS after somebody was gone: what was lost is said again, if need be several times."""


class _Stage(Enum):
    ASSEMBLING = "until the run begins"
    RECORDING = "until every node has made its last step and all its messages have arrived"
    BROKEN = "until everything that had arrived when the run broke off is written"
    CLOSING = "until the file is closed"
    SEEING_OFF = "until the others have left"


class RecorderMachine:
    """Records one run of ``plan`` as ``start``. ``path`` and ``endpoint`` only appear in texts.

    If the run breaks off, it has everything that has arrived written, marks the recording as incomplete, and says so.
    It waits ``patience_ns`` for processes that are gone. If the recording ``exists``, another start may
    have begun it: then this one goes on with it. It also does if it ``resumes`` a run whose processes are all gone:
    then it knows their last starts, and its own, by the recording.
    """

    def __init__(
        self,
        plan: Plan,
        start: str,
        endpoint: str,
        path: str,
        *,
        patience_ns: int = 0,
        exists: bool = False,
        resumes: Mapping[str, str] | None = None,
    ) -> None:
        self._member = Membership(
            RECORDER, plan, start, endpoint, self._prepare, leads=False, patience_ns=patience_ns, listens=exists
        )
        self._plan, self._realtime = plan, plan.clock == "realtime"
        self._path = path
        self._stage = _Stage.ASSEMBLING
        self._error: BaseException | None = None
        self._roles = Roles(plan, self._member.boots)
        self._ledger = Ledger(plan, self._roles)
        self._restarts = Restarts(self._member)
        self._recalling = Recalling(self._member, self._ledger)
        if resumes is not None:
            self._member.inherit(resumes)
        self._noted = 0  # restarts
        self._warnings = 0
        self._doubted = False
        self._standstill = Standstill()
        self._due_ns = NEVER_NS  # deadline for missing messages
        self._settling = False  # whether what is missing now was said to be sent
        self._flush_at_ns = 0
        self._returns = 0
        self._again_until_ns = 0  # until then nodes may say again what is missing before what they say
        self._last_word: LastWord | None = None

    def _prepare(self) -> Sequence[Effect]:
        again = self._member.successor
        if again:
            self._stage, self._ledger.rebuilt = _Stage.RECORDING, True
            self._member.caught_up = self._member.began = True
        return Subscribe(f"{RUN}**"), Open(again, anew=self._member.inherited)

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock at which Woke is due."""
        if self._stage is _Stage.BROKEN:
            return 0  # as soon as no arrival waits
        if self._last_word is not None:
            return min(self._member.wake_ns, self._last_word.wake_ns)
        wake_ns = min(self._member.wake_ns, self._due_ns)
        return min(wake_ns, self._flush_at_ns) if self._stage is _Stage.RECORDING else wake_ns

    def handle(self, event: Event, now: Now) -> Iterable[Effect]:
        """Return the effects of an event."""
        if (
            self._stage is _Stage.RECORDING
            and not self._ledger.ending
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
        yield from self._react(event, now)
        if self._stage is _Stage.ASSEMBLING and self._member.running:
            self._stage = _Stage.RECORDING
        if self._stage is _Stage.RECORDING:
            yield from self._record(now)
        elif self._last_word is not None and self._stage is _Stage.SEEING_OFF:
            yield from self._last_word.again(event, now.monotonic_ns)
            if self._last_word.over:
                yield Ended(self._error)

    def _react(self, event: Event, now: Now) -> Iterator[Effect]:
        member = self._member
        match event:
            case Arrived(key) if key.startswith(RECALL):
                yield from self._recall(event, now)
            case Arrived(key) if key.startswith(RUN):
                yield from self._hear(event, now)
            case Dropped(key):
                yield from self._refuse(key, event.error, now)
            case Closed(end):
                yield from self._confirm(end, now)
            case Flushed():
                member.kept = self._ledger.kept() if self._realtime or not self._ledger.missing() else member.kept
                self._ledger.window.confirm(member.kept)
            case Found():
                yield from self._rebuild(event, now)
            case _ if self._stage is _Stage.BROKEN:
                if type(event) is Woke:
                    yield from self._close_broken()
            case _ if self._stage is not _Stage.SEEING_OFF or type(event) is not StopAsked:
                self._restarts.began_ns = now.monotonic_ns if type(event) is Started else self._restarts.began_ns
                yield from member.handle(event, now.monotonic_ns)
                if type(event) is Token:
                    yield from self._greet(event, now)

    def _hear(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        stage, member = self._stage, self._member
        if stage is _Stage.ASSEMBLING:  # it comes from a stranger: others send nothing before all are ready
            yield from self._refuse(arrived.key, OrderError("the run has not begun"), now)
        elif stage in (_Stage.RECORDING, _Stage.BROKEN):
            yield from self._take(arrived, now)
        if now.monotonic_ns >= member.wake_ns and stage is not _Stage.BROKEN:
            yield from member.handle(arrived, now.monotonic_ns)

    def _close_broken(self) -> Iterator[Effect]:
        """Close the recording of a run that has broken off."""
        self._stage = _Stage.CLOSING
        began = self._ledger.ticks or self._ledger.messages
        stopped = "stopped by the user" if began else "stopped before the run began"
        yield from self._ledger.rest()
        yield Close(False, str(self._error) or stopped)

    def _greet(self, token: Token, now: Now) -> Iterator[Effect]:
        """Note who was started again, and answer who has asked before its token came."""
        if token.present:
            self._again_until_ns = now.monotonic_ns + AGAIN_NS
        restart = self._restarts.take(token, now.monotonic_ns)
        if restart is not None:
            yield from self._note(restart, now)
        for asked in self._recalling.early():
            yield from self._recall(asked, now)

    def _rebuild(self, found: Found, now: Now) -> Iterator[Effect]:
        """Go on with the recording of another start of the recorder."""
        member, ledger = self._member, self._ledger
        starts: dict[str, str] = {}
        yield from rebuilt(found.messages, ledger, self._plan.graph.topics, member.boots, starts, anew=member.inherited)
        member.ticks = ledger.ticks
        self._again_until_ns = now.monotonic_ns + AGAIN_NS
        if member.inherited:
            self._restarts.lose_all(now.monotonic_ns)
        took_s = (now.monotonic_ns - self._restarts.began_ns) / 10**9
        yield from self._note(
            Restart(node=RECORDER, before=member.before, start=member.start, tick=ledger.ticks, absent_s=took_s), now
        )
        if not member.inherited:
            for restart in list(self._restarts.missed(starts, now.monotonic_ns)):
                yield from self._note(restart, now)

    def _note(self, restart: Restart, now: Now) -> Iterator[Effect]:
        """Have it written that a process was started again."""
        yield Tell(f"{restart.node} is back: started again after tick {restart.tick}, in {restart.absent_s:.1f} s")
        if self._stage is _Stage.RECORDING:
            yield Record("recorder/restart", self._envelope(self._noted, now), encode("recorder/restart", restart))
            self._noted += 1

    def _envelope(self, number: int, now: Now) -> Envelope:
        ledger = self._ledger
        return Envelope(RECORDER, self._member.start, number, ledger.ticks, ledger.stamp_ns, now.wall_ns)

    def _record(self, now: Now) -> Iterator[Effect]:
        """Close the recording when the run is complete, or when missing messages have not come in time."""
        member, ledger = self._member, self._ledger
        if now.monotonic_ns >= self._flush_at_ns:
            self._flush_at_ns = now.monotonic_ns + FLUSH_NS
            yield Flush(now.monotonic_ns)
            yield Show(self._member.ticks, self._ledger.messages, self._paused)
            self._watch_doubtful(now)
        member.ticks = ledger.ticks
        ledger.patient = member.absence.disturbed
        member.over = ledger.finished if member.recovers else ledger.over
        if not ledger.ending:
            return
        if not member.recovers or not ledger.patient:
            member.leaving = True
        elif member.absence.missing or member.absence.returns != self._returns:
            self._returns, self._due_ns = member.absence.returns, NEVER_NS  # it will be said again
            if not ledger.ended or ledger.missing():
                return
        if self._ledger.ended and not self._ledger.missing():
            self._stage = _Stage.CLOSING
            yield from self._sum_up(now)
            doubt = self._ledger.doubt
            yield Close(not doubt, doubt or self._member.stop_reason or "finished", self._ledger.outcome)
        elif self._due_ns == NEVER_NS:
            self._due_ns = now.monotonic_ns + LATE_NS
        elif not self._settling and self._all_sent():
            settle_ns = AGAIN_NS if ledger.patient else SETTLE_NS
            self._settling, self._due_ns = True, min(self._due_ns, now.monotonic_ns + settle_ns)
        elif now.monotonic_ns >= self._due_ns:
            self._stage = _Stage.CLOSING
            yield from self._ledger.rest()
            yield from self._sum_up(now)
            yield Close(False, self._lacking())

    @property
    def _paused(self) -> bool:
        """Whether the source said last that an operator has paused the run."""
        heard = self._member.heartbeats.heard(self._ledger.source)
        return heard is not None and heard.beat.pace is not None and heard.beat.pace.paused

    def _all_sent(self) -> bool:
        """Return whether every node that lacks something says, by its heartbeat, that it has sent all, or is gone."""
        member = self._member
        lacking = self._ledger.lacking().items()
        return all(member.behind(name) > last or name not in member.present for name, last in lacking)

    def _sum_up(self, now: Now) -> Iterator[Effect]:
        """Tell of refusals that have not been told yet."""
        for text in self._member.refusals.rest():
            yield from self._warn(text, now)

    def _confirm(self, end: RunEnd, now: Now) -> Iterator[Effect]:
        """Announce that the file is closed; after a complete run, wait until the others have left."""
        self._member.leaving = True
        recorded = Recorded(self._member.start, end.complete, printable(end.reason), self._path)
        self._last_word = LastWord(recorded, self._member, now.monotonic_ns, waits=not self._ledger.ended)
        yield self._last_word.put
        if self._error is not None:
            yield Ended(self._error)
            return
        self._stage = _Stage.SEEING_OFF
        if not end.complete:
            self._error = RunError(f"{self._path} is incomplete: {end.reason}")

    def _recall(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        """Tell a node's new start what its predecessor has read and done, or that the run is over."""
        if self._stage is _Stage.SEEING_OFF and self._last_word is not None:
            yield self._last_word.put
        if self._stage is not _Stage.RECORDING or not self._member.recovers:
            return
        try:
            yield from self._recalling.hear(arrived, self._restarts.gone_ns, now.monotonic_ns)
        except ProtocolError as error:
            yield from self._refuse(arrived.key, error, now)

    def _take(self, arrived: Arrived, now: Now) -> Iterable[Effect]:
        key, roles, ledger = arrived.key, self._roles, self._ledger
        try:
            if key.startswith(AGAIN):
                arrived = roles.again(arrived)
                key = arrived.key
            if key.startswith(DATA):
                name, sender, envelope = roles.message(arrived)
                records: Sequence[Record] = ledger.message(name, sender, envelope, arrived.payload)
            elif key.startswith(JOURNAL):
                records = list(ledger.entry(*roles.entry(arrived), arrived.payload))
            else:
                records = list(ledger.end(roles.tick(arrived)))
        except ProtocolError as error:
            told = () if self._may_come_again(error, now) else self._refuse(key, error, now)
            return [*told, *self._doubt(now)]
        if ledger.dropped or ledger.doubt:
            return [*records, *self._drop(now), *self._doubt(now)]
        return records

    def _may_come_again(self, error: ProtocolError, now: Now) -> bool:
        """Return whether a message is out of order because somebody was away: it was said again, or is going to be."""
        if isinstance(error, RepeatError):
            return self._member.absence.disturbed
        return self._realtime and isinstance(error, OrderError) and now.monotonic_ns < self._again_until_ns

    def _drop(self, now: Now) -> Iterator[Effect]:
        for topic, error in self._ledger.dropped:
            yield from self._refuse(DATA + topic, error, now)
        self._ledger.dropped.clear()

    def _doubt(self, now: Now) -> Iterator[Effect]:
        """Tell once that the run is doubtful, and break it off if it cannot end by itself."""
        doubt = self._ledger.doubt
        if doubt and not self._doubted:
            self._doubted = True
            yield from self._warn(f"{doubt}: somebody speaks in its name; the recording is marked incomplete", now)
        if self._ledger.split:
            self._break_off()

    def _break_off(self) -> None:
        """End a doubtful run that cannot end by itself."""
        if self._stage is _Stage.RECORDING:
            self._stage, self._error = _Stage.BROKEN, RunError(f"the run cannot go on: {self._ledger.doubt}")

    def _watch_doubtful(self, now: Now) -> None:
        """Break a doubtful run off that makes no step any more: a stranger may have driven nodes out of step."""
        still = self._standstill.lasts(self._ledger.written, now.monotonic_ns, paused=self._paused)
        if still and self._ledger.doubt:
            self._break_off()

    def _refuse(self, key: str, error: ProtocolError, now: Now) -> Iterator[Effect]:
        text = self._member.refusals.note(key, error, now.monotonic_ns)
        if text is not None:
            yield from self._warn(text, now)

    def _warn(self, text: str, now: Now) -> Iterator[Effect]:
        """Tell a text, and have it written if the recording has begun."""
        yield Tell(text)
        if self._stage is _Stage.ASSEMBLING:
            return
        stamp_ns = self._ledger.stamp_ns
        envelope = self._envelope(self._warnings, now)
        self._warnings += 1
        message = Log(timestamp=timestamp(stamp_ns), level=LogLevel.WARNING, message=text, name=RECORDER)
        yield Record("log", envelope, encode("log", message))

    def _lacking(self) -> str:
        missing = self._ledger.missing()
        lacking = "never arrived: " + ", ".join(f"{count} on {topic}" for topic, count in sorted(missing.items()))
        return f"{self._ledger.doubt}; {lacking}" if self._ledger.doubt else lacking
