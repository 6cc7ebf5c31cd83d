"""The host of one node: receives messages, decides when the node steps, numbers, encodes, journals and publishes."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

from dynpf_protocol.control import Outcome, TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import DynpfError, OrderError, ProtocolError, RepeatError, RunError
from dynpf_protocol.journal import JournalEntry, encode_entry
from dynpf_protocol.keys import ACT, JOURNAL, RECALLED, RECORDER, RUN, TICK, data_keys
from dynpf_protocol.messages import LogLevel
from dynpf_protocol.recall import Piece
from dynpf_protocol.topics import is_record

from dynpf_runtime.inbox import RealtimeInbox
from dynpf_runtime.machines.acting import Acting, told
from dynpf_runtime.machines.deafness import AHEAD, Deafness
from dynpf_runtime.machines.effects import NEVER_NS, Effect, Ended, Put, Subscribe, Tell
from dynpf_runtime.machines.events import Arrived, Dropped, Event, Now, Woke
from dynpf_runtime.machines.gauges import Gauges
from dynpf_runtime.machines.housed import Housed
from dynpf_runtime.machines.intake import Refusal
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.recollection import Recollection
from dynpf_runtime.machines.repeating import Repeating
from dynpf_runtime.machines.reporting import Reporting
from dynpf_runtime.machines.roster import boot_of
from dynpf_runtime.machines.saying import Saying, StepSaid, put_of
from dynpf_runtime.machines.turns import Beginning, FollowLockstep, LeadLockstep, Turn, Turns, turns_of
from dynpf_runtime.node import Node
from dynpf_runtime.plan import Plan
from dynpf_runtime.source import LiveSource, LogRecord

__all__ = ["NodeHost"]

RECORDED_NS = 30_000_000_000
"""How long the recorder may take, after the last step, to confirm the run."""


class NodeHost:
    """The process of ``node`` as ``start``, from joining to the recorder's confirmation of the run.

    ``log`` has the records that the source plays, if it plays one, or ``live`` gives them as they arrive; ``endpoint``
    only appears in texts. It waits ``patience_ns`` for processes that are gone, and takes over from another start of
    its own: in lockstep the run stands still meanwhile, in realtime it goes on.
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
        self._plan, self._awaited = plan, graph.awaited
        self._log, self._live = log, live
        self._gauges = gauges
        self._leads = name == graph.source
        keys = [*map(data_keys, graph.subscribed(name)), *(TICK + other for other in graph.lags[name])]
        listened = [Subscribe(key) for key in (*keys, RECALLED + name, *([f"{ACT}**"] if self._leads else []))]
        self._member = Membership(
            name, plan, start, endpoint, lambda: listened, leads=self._leads, patience_ns=patience_ns
        )
        self._housed = Housed(name, node, plan, start, self._member.boots)
        self._turns: Turns | None = None  # None until the run begins
        self._running = False
        self._realtime = plan.clock == "realtime"
        self._saying = Saying(self._member, realtime=self._realtime)
        self._recollection = Recollection(self._member)
        self._repeating = Repeating(name, graph.topics)
        self._acting = Acting(graph, self._member.operators, plan.rate, paced=live is None)
        self._member.pace = self._acting.pace if self._leads else None
        self._reporting = Reporting(self._member, gauges)
        self._recorded_by_ns = NEVER_NS
        self._stepped_ns = 0  # when the last step was, or the run began
        self._deafness = Deafness(name, plan, self._member)

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock at which Woke is due."""
        saying_ns = self._saying.wake_ns if self._member.caught_up else NEVER_NS  # before, nothing is said again
        wake_ns = min(self._member.wake_ns, saying_ns, self._recollection.wake_ns)
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
            refusal = self._housed.intake.take(event, now.monotonic_ns)
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

    def _handle(self, event: Event, now: Now) -> Iterator[Effect]:
        member = self._member
        yield from member.handle(event, now.monotonic_ns)
        if type(event) is Arrived and event.key.startswith(ACT):
            yield from self._asked(event, now)
        if member.successor and not member.caught_up:
            yield from self._catch_up(event, now)
            return
        yield from self._say_again(now)
        if type(event) is Dropped:
            yield from self._refuse(Refusal(event.key, event.error), now)
        elif type(event) is Arrived and event.key.startswith(RUN):
            if self._turns is None:  # it comes from a stranger: others send nothing before this process is ready
                yield from self._refuse(Refusal(event.key, OrderError("the run has not begun")), now)
            elif self._running and (refusal := self._housed.intake.take(event, now.monotonic_ns)) is not None:
                yield from self._refuse_or_put_off(refusal, event, now)
        if self._turns is None and member.running:
            self._turns, self._running, self._stepped_ns = self._turns_of(now), True, now.monotonic_ns
        if self._running and member.running:
            yield from self._advance(now, self._turn(now, idle=type(event) is Woke))
            if type(event) is Woke:
                paced = self._plan.rate is not None or self._acting.paused
                yield from self._deafness.notice(self._leads, paced, self._stepped_ns, now.monotonic_ns)
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
            (self._repeating.keep_end if self._realtime else past.put_off)(event)
        elif member.alive and (past.wake_ns == NEVER_NS or now.monotonic_ns >= past.wake_ns):
            if self._housed.executor.boot != boot_of(member.start):
                self._take_over(self._housed.executor.node)
                self._turns, self._running = self._turns_of(now), True
            yield past.ask(now.monotonic_ns)

    def _recalled(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        past, member = self._recollection, self._member
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
        self._saying.silent = True
        for piece in answer.pieces:
            yield from self._repeat_piece(piece, now) if self._realtime else self._take_piece(piece, now)
        if not self._realtime:
            yield from self._repeat(now)
        self._saying.silent = False
        if answer.more:
            yield past.ask(now.monotonic_ns)
            return
        for topic, sequence in answer.sequences.items():
            if not is_record(topic):
                self._housed.executor.number_from(topic, sequence)
        past.wake_ns = NEVER_NS
        member.caught_up, member.began = True, past.said > 0 or member.ticks > 0
        self._stepped_ns = now.monotonic_ns
        if self._realtime:
            yield from self._go_on(answer.sequences, now)
        yield from self._take_waiting(now)
        yield from self._handle(Woke(), now)

    def _go_on(self, numbers: Mapping[str, int], now: Now) -> Iterator[Effect]:
        """In realtime, go on with what comes now. What was said last goes to the recorder alone, which may lack it."""
        inbox = self._housed.inbox
        assert isinstance(inbox, RealtimeInbox)
        inbox.forget_late()
        inbox.missed()
        self._saying.rouse(now.monotonic_ns)
        if self._running:
            self._turns = self._turns_of(now, self._member.ticks, numbers)
        for arrived in self._repeating.ends():
            if (refusal := self._housed.intake.take(arrived, now.monotonic_ns)) is not None:
                yield from self._refuse(refusal, now)

    def _repeat_piece(self, piece: Piece, now: Now) -> Iterator[Effect]:
        """In realtime, make a step again whose entry is here."""
        again = self._repeating.take(piece, self._housed.gaps)
        if again is None or self._member.ticks > again.turn.ready.tick:
            return
        assert isinstance(self._housed.inbox, RealtimeInbox)
        self._housed.inbox.took(again.turn.ready)
        self._recollection.expect(again.turn.ready.tick, again.entry)
        for topic, sequence in again.numbers.items():
            self._housed.executor.number_from(topic, sequence)
        yield from self._step(again.turn, now)
        self._saying.confirm(but_last=True)

    def _take_piece(self, piece: Piece, now: Now) -> Iterator[Effect]:
        """In lockstep, take what the predecessor has read, and make the steps again of which all is here."""
        if self._leads and self._acting.recall(Arrived(piece.key, piece.payload, piece.attachment), self._spec.name):
            return
        refusal = self._housed.intake.take(Arrived(piece.key, piece.payload, piece.attachment), now.monotonic_ns)
        if refusal is not None and not isinstance(refusal.error, RepeatError):
            yield from self._refuse(refusal, now)
        yield from self._repeat(now)

    def _go_on_from(self, snapshot: bytes, now: Now) -> None:
        """Take the place of the predecessor after a snapshot's step; raises RunError if it is none of this node."""
        member = self._member
        self._take_over(self._spec.build())
        member.ticks = self._housed.go_on_from(snapshot)
        self._turns = self._turns_of(now, member.ticks)
        if isinstance(self._housed.inbox, RealtimeInbox):
            late = self._housed.inbox.forget_late()
            self._repeating.held = {(one.node, one.topic, one.sequence): one for one in late}

    def _take_over(self, node: Node) -> None:
        """Begin with a node in its first state under the name of the predecessor, and with nothing said."""
        member = self._member
        self._housed = Housed(self._spec.name, node, self._plan, boot_of(member.start), member.boots)
        self._saying.forget()

    def _take_waiting(self, now: Now) -> Iterator[Effect]:
        """Take what others have said while this process was behind them."""
        for arrived in self._recollection.due(self._housed.inbox.tick):
            if (refusal := self._housed.intake.take(arrived, now.monotonic_ns)) is not None:
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
            self._saying.confirm(but_last=True)

    def _say_again(self, now: Now) -> Iterator[Effect]:
        """Say again what the recorder has not confirmed, if somebody has come back who may have missed it."""
        saying = self._saying
        if not self._member.recovers:
            return
        over = self._turns is not None and not self._running  # the last step is confirmed by the recorder's last word
        saying.confirm(but_last=over)
        if saying.returned(now.monotonic_ns):
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS if over else NEVER_NS
            if isinstance(self._housed.inbox, RealtimeInbox):
                self._housed.inbox.missed()
        yield from saying.again(now.monotonic_ns, over=over)

    def _turns_of(self, now: Now, begun: int = 0, numbers: Mapping[str, int] = {}) -> Turns:
        """Return the turns after the first ``begun`` ticks; ``numbers`` are the next ones of a live robot's records."""
        boot, inbox = self._housed.executor.boot if self._leads else None, self._housed.inbox
        begins = Beginning(begun, self._reporting.stamp_ns, numbers)
        return turns_of(self._plan, inbox, boot, begins, log=self._log, live=self._live, wall_ns=now.wall_ns)

    def _turn(self, now: Now, *, idle: bool) -> Turn | None:
        turns, member = self._turns, self._member
        assert turns is not None
        held = not self._realtime and self._leads and member.ticks - member.behind(RECORDER) > AHEAD
        stopping = bool(member.stop_reason)
        held = held or (self._leads and not stopping and self._acting.holds(member.ticks))
        if member.recovers:
            past, saying = self._recollection, self._saying
            held = held or saying.full
            held = held or (not member.ticks and not member.successor and member.strange)
            if not self._realtime:
                # The source waits for who is gone; and what is new does not overtake what is to be said again.
                held = held or member.absence.cut or saying.urgent or (self._leads and member.absence.missing)
            if not self._realtime and member.ticks < past.said:
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
        name, executor = self._spec.name, self._housed.executor
        self._stepped_ns = now.monotonic_ns
        again = self._saying.silent or tick < self._recollection.said
        acts = self._acting.enter(executor, turn, now.wall_ns, again=again)
        inputs[:0] = acts.read
        events = self._housed.reports(turn, now.wall_ns)
        self._reporting.begins(tick, stamp_ns)
        executed = executor.step(tick, stamp_ns, inputs, now.wall_ns)
        self._reporting.ends()
        last = turn.last or executed.finished
        hosted = (*acts.sent, *turn.fed, *events)
        sent = (*hosted, *executed.sent)
        report = None
        if not self._saying.silent and (last or self._reporting.due(now.monotonic_ns)):
            report = self._reporting.diagnostics(executor, now)
        outcome = self._outcome(finished=executed.finished) if last and self._leads else None
        counts = dict(Counter(message.topic for message in sent))
        done = TickDone(name, executor.boot, tick, tick, stamp_ns, counts, last, outcome)

        def enter() -> tuple[JournalEntry, Put]:
            self._gauges.stepping(tick)  # the digest of a large state
            entry = executor.journal(tick, stamp_ns, inputs, executed.sent, hosted=hosted, last=last)
            if self._saying.silent:
                self._recollection.check(entry)
            envelope = Envelope(name, executor.boot, entry.step, tick, stamp_ns, now.wall_ns)
            return entry, Put(JOURNAL + name, encode_entry(entry), encode_envelope(envelope))

        said = StepSaid(hosted, executed.sent, report, Put(TICK + name, encode_control(done)))
        entry = yield from self._saying.step(said, self._awaited, enter)
        if (snapshot := self._housed.snapshots.after(entry, sent, now.wall_ns, now.monotonic_ns)) is not None:
            yield from self._saying.say(put_of(snapshot))
        self._member.ticks = tick + 1
        for text in acts.refused:
            yield from self._tell(LogLevel.WARNING, text, now)
        if last:
            self._running = False
            self._member.leaving = True
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS

    def _asked(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        """Take what an operator asks of the source."""
        try:
            pace = self._acting.hear(arrived, self._member.ticks)
        except ProtocolError as error:
            yield from self._refuse(Refusal(arrived.key, error), now)
            return
        if pace is not None:
            self._plan = self._plan._replace(rate=pace.rate or None)
            if self._turns is not None:
                self._turns.pace(self._plan.rate)
            if not (pace.paused and self._acting.paused):
                yield from self._tell(LogLevel.INFO, told(pace), now)
            self._member.pace = self._acting.pace = pace

    def _tell(self, level: LogLevel, text: str, now: Now) -> Iterator[Effect]:
        yield Tell(text)
        if self._running:
            yield from self._saying.say(self._reporting.text(level, text, self._housed.executor, now))

    def _outcome(self, *, finished: bool) -> Outcome:
        if finished:
            return Outcome.DONE
        return Outcome.STOPPED if self._member.stop_reason else Outcome.BUDGET

    def _refused(self, refusal: Refusal, arrived: Arrived, now: Now) -> Iterator[Effect]:
        yield from self._refuse_or_put_off(refusal, arrived, now)
        yield from self._advance(now, self._turn(now, idle=False))  # the inbox no longer waits for it

    def _refuse_or_put_off(self, refusal: Refusal, arrived: Arrived, now: Now) -> Iterator[Effect]:
        """Refuse a message, unless this process takes over, and is behind its sender."""
        if self._member.successor and not self._realtime and type(refusal.error) is OrderError:
            self._recollection.put_off(arrived)
        else:
            yield from self._refuse(refusal, now)

    def _refuse(self, refusal: Refusal, now: Now) -> Iterator[Effect]:
        if isinstance(refusal.error, RepeatError) and self._member.absence.disturbed:
            return  # a peer says again what somebody may have missed
        text = self._member.refusals.note(*refusal, now.monotonic_ns)
        if text is not None:
            yield from self._tell(LogLevel.WARNING, text, now)

    def _await_recorded(self, now: Now) -> Iterator[Effect]:
        """End when the recorder has confirmed the run; raises RunError if it does not in time."""
        if self._member.recorded is not None:
            yield Ended()
        elif self._member.absence.missing:
            self._recorded_by_ns = now.monotonic_ns + RECORDED_NS
        elif now.monotonic_ns >= self._recorded_by_ns:
            raise RunError(f"the recorder has not confirmed the run within {RECORDED_NS // 10**9} s")
