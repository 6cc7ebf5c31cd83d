"""The host of one node: receives messages, decides when the node steps, numbers, encodes, journals and publishes."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from dynpf_protocol.control import Outcome, TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import BadMessageError, DynpfError, OrderError, ProtocolError, RepeatError, RunError
from dynpf_protocol.journal import encode_entry, genesis
from dynpf_protocol.keys import JOURNAL, RECALLED, RECORDER, RUN, TICK, data_key, data_keys
from dynpf_protocol.messages import Diagnostics, Log, LogLevel, timestamp
from dynpf_protocol.restoring import decode_snapshot
from dynpf_protocol.topics import EVENT_PREFIX

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.inbox import LockstepInbox, RealtimeInbox
from dynpf_runtime.machines.deafness import AHEAD, Deafness
from dynpf_runtime.machines.effects import NEVER_NS, Effect, Ended, Put, Subscribe, Tell
from dynpf_runtime.machines.events import Arrived, Dropped, Event, Now, Woke
from dynpf_runtime.machines.gauges import Gauges
from dynpf_runtime.machines.intake import Intake, Refusal
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.recollection import Recollection
from dynpf_runtime.machines.roles import Roles
from dynpf_runtime.machines.roster import boot_of
from dynpf_runtime.machines.turns import FollowLockstep, LeadLockstep, Turn, Turns, turns_of
from dynpf_runtime.machines.unconfirmed import MOST_UNCONFIRMED, Unconfirmed
from dynpf_runtime.node import Node
from dynpf_runtime.plan import Plan
from dynpf_runtime.snapshot import Snapshots, thaw_host
from dynpf_runtime.source import LiveSource, LogRecord

__all__ = ["NodeHost"]

REPORT_NS = 1_000_000_000
RECORDED_NS = 30_000_000_000
"""How long the recorder may take, after the last step, to confirm the run."""


class NodeHost:
    """The process of ``node`` as ``start``, from joining to the recorder's confirmation of the run.

    ``log`` has the records that the source plays, if it plays one, or ``live`` gives them as they arrive; ``endpoint``
    only appears in texts. In lockstep it waits ``patience_ns`` for processes that are gone, and takes over from another
    start of its own.
    """

    def __init__(
        self,
        name: str,
        node: Node,
        plan: Plan,
        start: str,
        *,
        endpoint: str,
        log: Sequence[LogRecord],
        gauges: Gauges,
        patience_ns: int = 0,
        live: LiveSource | None = None,
    ) -> None:
        graph = plan.graph
        self._spec = graph.specs[name]
        self._plan = plan
        self._awaited = graph.awaited
        self._log = log
        self._live = live
        self._gauges = gauges
        self._leads = name == graph.source
        keys = [*map(data_keys, graph.subscribed(name)), *(TICK + other for other in graph.lags[name])]
        self._keys = [*keys, RECALLED + name]
        self._member = Membership(
            name, plan, start, endpoint, self._prepare, leads=self._leads, patience_ns=patience_ns
        )
        self._begin_with(node, start)
        self._turns: Turns | None = None  # None until the run begins
        self._running = False
        self._unconfirmed = Unconfirmed()
        self._recollection = Recollection(self._member)
        self._silent = False  # while it makes steps that its predecessor has made
        self._returns = 0  # how often a peer had come back when this process last looked
        self._recorded_by_ns = NEVER_NS
        self._step_time_s = 0.0
        self._report_at_ns = 0
        self._stepped_ns = 0  # when the last step was, or the run began
        self._deafness = Deafness(name, plan, self._member)
        self._stamp_ns = 0

    def _begin_with(self, node: Node, boot: str) -> None:
        """Put a node in its first state behind an empty inbox."""
        plan, name = self._plan, self._spec.name
        graph, chain = plan.graph, genesis(name, plan.text)
        self._executor = Executor(node, self._spec, graph.topics, boot, plan.state_digest_ticks, chain=chain)
        self._gaps = GapWatch()
        link = FaultyLink(plan.faults, name, plan.seed)
        self._inbox = (LockstepInbox if plan.clock == "lockstep" else RealtimeInbox)(graph, name, link)
        self._snapshots = Snapshots(self._executor, self._gaps, self._inbox)
        self._intake = Intake(Roles(plan, self._member.boots), self._inbox)

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock at which Woke is due."""
        wake_ns = min(self._member.wake_ns, self._unconfirmed.wake_ns, self._recollection.wake_ns)
        if self._turns is None or not self._running:
            return min(wake_ns, self._recorded_by_ns)
        return min(wake_ns, self._turns.wake_ns) if self._member.running else wake_ns  # who may not step yet, waits

    def handle(self, event: Event, now: Now) -> Iterable[Effect]:
        """Return the effects of an event; messages that other nodes wait for come first, the journal last."""
        if (
            self._running
            and self._member.running
            and type(event) is Arrived
            and event.key.startswith(RUN)
            and now.monotonic_ns < self._member.wake_ns
        ):  # the most frequent case takes the shortest path
            refusal = self._intake.take(event, now.monotonic_ns)
            if refusal is None:
                turn = self._turn(now, idle=False)
                return () if turn is None else self._caught(self._advance(now, turn))
            return self._caught(self._refused(refusal, event, now))
        return self._caught(self._handle(event, now))

    @staticmethod
    def _caught(effects: Iterator[Effect]) -> Iterator[Effect]:
        try:
            yield from effects
        except (DynpfError, KeyboardInterrupt) as error:
            yield Ended(error)

    def _prepare(self) -> list[Effect]:
        return [Subscribe(key) for key in self._keys]

    def _handle(self, event: Event, now: Now) -> Iterator[Effect]:
        member = self._member
        yield from member.handle(event, now.monotonic_ns)
        if member.successor and not member.caught_up:
            yield from self._catch_up(event, now)
            return
        yield from self._say_again(now)
        if type(event) is Dropped:
            yield from self._refuse(Refusal(event.key, event.error), now)
        elif type(event) is Arrived and event.key.startswith(RUN):
            if self._turns is None:  # it comes from a stranger: others send nothing before this process is ready
                yield from self._refuse(Refusal(event.key, OrderError("the run has not begun")), now)
            elif self._running and (refusal := self._intake.take(event, now.monotonic_ns)) is not None:
                yield from self._refuse_or_put_off(refusal, event, now)
        if self._turns is None and member.running:
            self._turns, self._running, self._stepped_ns = self._turns_of(now), True, now.monotonic_ns
        if self._running and member.running:
            yield from self._advance(now, self._turn(now, idle=type(event) is Woke))
            if type(event) is Woke:
                yield from self._deafness.notice(self._leads, self._stepped_ns, now.monotonic_ns)
        elif self._turns is not None and not self._running:
            yield from self._await_recorded(now)

    def _catch_up(self, event: Event, now: Now) -> Iterator[Effect]:
        """Get what the predecessor has read, and make its steps again, until this process is where that was."""
        past, member = self._recollection, self._member
        if member.recorded is not None:
            yield Ended()
        elif type(event) is Arrived and event.key.startswith(RECALLED):
            yield from self._recalled(event, now)
        elif type(event) is Arrived and event.key.startswith(RUN):
            past.put_off(event)
        elif member.alive and (past.wake_ns == NEVER_NS or now.monotonic_ns >= past.wake_ns):
            if self._executor.boot != boot_of(member.start):
                self._executor.boot, self._unconfirmed = boot_of(member.start), Unconfirmed()
            if self._turns is None:
                self._turns, self._running = self._turns_of(now), True
            yield past.ask(now.monotonic_ns)

    def _recalled(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        past, member, executor = self._recollection, self._member, self._executor
        try:
            answer = past.answered(arrived)
        except ProtocolError as error:
            yield from self._refuse(Refusal(arrived.key, error), now)
            return
        if answer is None:
            return
        member.stop_reason = member.stop_reason or answer.stop_reason
        if answer.snapshot:
            self._go_on_from(answer.snapshot, now)
        self._silent = True
        for piece in answer.pieces:
            refusal = self._intake.take(Arrived(piece.key, piece.payload, piece.attachment), now.monotonic_ns)
            if refusal is not None and not isinstance(refusal.error, RepeatError):
                yield from self._refuse(refusal, now)
            yield from self._repeat(now)
        yield from self._repeat(now)
        self._silent = False
        if answer.more:
            yield past.ask(now.monotonic_ns)
            return
        for topic, sequence in answer.sequences.items():
            executor.number_from(topic, sequence)
        past.wake_ns = NEVER_NS
        member.caught_up, member.began = True, past.said > 0
        self._stepped_ns = now.monotonic_ns
        yield from self._take_waiting(now)
        yield from self._handle(Woke(), now)

    def _go_on_from(self, payload: bytes, now: Now) -> None:
        """Take the place of the predecessor after the step of a snapshot; raises RunError if it is none of this node.

        The recorder has found it to be of the state that the predecessor's journal has.
        """
        name, boot = self._spec.name, boot_of(self._member.start)
        try:
            snapshot = decode_snapshot(payload)
            self._begin_with(self._spec.build(), boot)
            thaw_host(snapshot, self._executor, self._gaps, self._inbox)
        except BadMessageError as error:
            raise RunError(f"{name} cannot come back: {error}") from error
        self._unconfirmed, self._member.ticks = Unconfirmed(), snapshot.tick + 1
        self._turns = self._turns_of(now, self._member.ticks)

    def _take_waiting(self, now: Now) -> Iterator[Effect]:
        """Take what others have said while this process was behind them."""
        for arrived in self._recollection.due(self._inbox.tick):
            if (refusal := self._intake.take(arrived, now.monotonic_ns)) is not None:
                yield from self._refuse(refusal, now)

    def _repeat(self, now: Now) -> Iterator[Effect]:
        """Make the steps again whose inputs are here."""
        past, turns = self._recollection, self._turns
        assert isinstance(turns, FollowLockstep | LeadLockstep)
        while self._running and self._member.ticks < past.written:
            turn = turns.repeat(stopping=self._member.ticks == past.last)
            if turn is None:
                return
            yield from self._step(turn, now)
            self._unconfirmed.confirm(min(self._member.heartbeats.kept(RECORDER), self._member.ticks - 1))

    def _say_again(self, now: Now) -> Iterator[Effect]:
        """Say again what the recorder has not confirmed, if somebody has come back who may have missed it."""
        member, unconfirmed = self._member, self._unconfirmed
        if not member.recovers:
            return
        over = self._turns is not None and not self._running  # the last step is confirmed by the recorder's last word
        unconfirmed.confirm(
            min(member.heartbeats.kept(RECORDER), member.ticks - 1) if over else member.heartbeats.kept(RECORDER)
        )
        if member.absence.returns != self._returns:
            self._returns = member.absence.returns
            unconfirmed.rouse(now.monotonic_ns, member.ticks)
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS if over else NEVER_NS
        yield from unconfirmed.again(now.monotonic_ns)

    def _said(self, put: Put) -> tuple[Put, ...]:
        """Return a message to publish, unless the predecessor has; it is kept until it is confirmed."""
        if self._member.recovers:
            self._unconfirmed.add(self._member.ticks, put)
        return () if self._silent else (put,)

    def _turns_of(self, now: Now, begun: int = 0) -> Turns:
        """Return the turns after the first ``begun`` ticks."""
        boot = self._executor.boot if self._leads else None
        return turns_of(self._plan, self._inbox, boot, begun, log=self._log, live=self._live, wall_ns=now.wall_ns)

    def _turn(self, now: Now, *, idle: bool) -> Turn | None:
        turns, member = self._turns, self._member
        assert turns is not None
        held = self._leads and member.ticks - member.behind(RECORDER) > AHEAD
        stopping = bool(member.stop_reason)
        if member.recovers:
            past, unconfirmed = self._recollection, self._unconfirmed
            # The source waits for who is gone; and what is new does not overtake what is to be said again.
            held = held or member.absence.cut or unconfirmed.urgent or unconfirmed.bytes > MOST_UNCONFIRMED
            held = held or (self._leads and member.absence.missing)
            held = held or (not member.ticks and not member.successor and member.strange)
            if member.ticks < past.said:
                stopping = member.ticks == past.last
        return turns.take(now.monotonic_ns, idle=idle, stopping=stopping, held=held)

    def _advance(self, now: Now, turn: Turn | None) -> Iterator[Effect]:
        """Make all steps that are due; the source only one, so that other events are handled between two ticks."""
        while turn is not None:
            yield from self._step(turn, now)
            late = self._recollection.waiting  # after a predecessor's end
            if late:
                yield from self._take_waiting(now)
            if not self._running or (self._leads and not late):
                return
            turn = self._turn(now, idle=False)

    def _step(self, turn: Turn, now: Now) -> Iterator[Effect]:
        """Run one step and publish its results."""
        (tick, _, inputs, _), stamp_ns = turn.ready, turn.stamp_ns
        name, executor = self._spec.name, self._executor
        self._stamp_ns, self._stepped_ns = stamp_ns, now.monotonic_ns
        events = notice_gaps(executor, self._gaps, turn.ready, stamp_ns, now.wall_ns)
        events += [executor.stamp(EVENT_PREFIX + name, gap, tick, stamp_ns, now.wall_ns) for gap in turn.gaps]
        self._gauges.stepping(tick)
        began_s = self._gauges.stopwatch_s()
        executed = executor.step(tick, stamp_ns, inputs, now.wall_ns)
        self._step_time_s += self._gauges.stopwatch_s() - began_s
        last = turn.last or executed.finished
        hosted = (*turn.fed, *events)
        sent = (*hosted, *executed.sent)
        # Messages that other nodes wait for go first; those for the recorder and observers, and the journal, follow.
        for message in sent:
            if message.topic in self._awaited:
                yield from self._said(_put(message))
        counts = dict(Counter(message.topic for message in sent))
        if not self._silent and (last or now.monotonic_ns >= self._report_at_ns):
            yield from self._said(self._report(now))  # the last report precedes the end of the last tick
        outcome = self._outcome(finished=executed.finished) if last and self._leads else None
        done = TickDone(name, executor.boot, executor.steps, tick, stamp_ns, counts, last, outcome)
        yield from self._said(Put(TICK + name, encode_control(done)))
        for message in sent:
            if message.topic not in self._awaited:
                yield from self._said(_put(message))
        self._gauges.stepping(tick)  # the digest of a large state
        entry = executor.journal(tick, stamp_ns, inputs, executed.sent, hosted=hosted, last=last)
        envelope = Envelope(name, executor.boot, entry.step, tick, stamp_ns, now.wall_ns)
        if self._silent:
            self._recollection.check(entry)
        yield from self._said(Put(JOURNAL + name, encode_entry(entry), encode_envelope(envelope)))
        if (snapshot := self._snapshots.after(entry, sent, now.wall_ns, now.monotonic_ns)) is not None:
            yield from self._said(_put(snapshot))
        self._member.ticks = tick + 1
        if last:
            self._running = False
            self._member.leaving = True
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS

    def _outcome(self, *, finished: bool) -> Outcome:
        if finished:
            return Outcome.DONE
        return Outcome.STOPPED if self._member.stop_reason else Outcome.BUDGET

    def _refused(self, refusal: Refusal, arrived: Arrived, now: Now) -> Iterator[Effect]:
        yield from self._refuse_or_put_off(refusal, arrived, now)
        yield from self._advance(now, self._turn(now, idle=False))  # the inbox no longer waits for it

    def _refuse_or_put_off(self, refusal: Refusal, arrived: Arrived, now: Now) -> Iterator[Effect]:
        """Refuse a message, unless this process takes over, and is behind its sender."""
        if self._member.successor and type(refusal.error) is OrderError:
            self._recollection.put_off(arrived)
        else:
            yield from self._refuse(refusal, now)

    def _refuse(self, refusal: Refusal, now: Now) -> Iterator[Effect]:
        if isinstance(refusal.error, RepeatError) and self._member.absence.disturbed:
            return  # a peer says again what somebody may have missed
        text = self._member.refusals.note(*refusal, now.monotonic_ns)
        if text is None:
            return
        yield Tell(text)
        if self._running:
            stamp = timestamp(self._stamp_ns)
            message = Log(timestamp=stamp, level=LogLevel.WARNING, message=text, name=self._spec.name)
            yield from self._said(self._stamped("log", message, now))

    def _report(self, now: Now) -> Put:
        self._report_at_ns = now.monotonic_ns + REPORT_NS
        message = Diagnostics(
            node=self._spec.name,
            steps=self._executor.steps,
            step_time_s=self._step_time_s,
            refused=dict(self._member.refusals.counts),
            queue=self._gauges.waiting(),
        )
        return self._stamped("diagnostics", message, now)

    def _stamped(self, topic: str, message: Diagnostics | Log, now: Now) -> Put:
        return _put(self._executor.stamp(topic, message, self._member.ticks, self._stamp_ns, now.wall_ns))

    def _await_recorded(self, now: Now) -> Iterator[Effect]:
        """End when the recorder has confirmed the run; raises RunError if it does not in time."""
        if self._member.recorded is not None:
            yield Ended()
        elif self._member.absence.missing:
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS
        elif now.monotonic_ns >= self._recorded_by_ns:
            raise RunError(f"the recorder has not confirmed the run within {RECORDED_NS // 10**9} s")


def _put(sent: Sent) -> Put:
    return Put(data_key(sent.topic, sent.envelope.node), sent.payload, encode_envelope(sent.envelope))
