"""Membership: how a process joins a run, knows its peers, sends heartbeats, and notices that a peer is gone.

A process joins in two steps: *alive* when its subscriptions are in place, *ready* when it has seen every peer alive.
The source begins when all are ready, so no message can precede its subscribers, and every sender is known by its boot.

A process may be started again in mid-run. It learns from its peers' heartbeats that it has predecessors,
is alive when those are gone, and ready when it has caught up with them; the peers wait for it.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

from dynpf_protocol.control import Beat, Pace, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import BrokenOffError, OrderError, ProtocolError, UnknownSenderError, UsageError
from dynpf_protocol.keys import ALIVE, BEAT, CONTROL, OPERATOR, READY, RECORDED, RECORDER, ROUTER, STOP
from dynpf_protocol.printable import printable

from dynpf_runtime.machines.absence import Absence
from dynpf_runtime.machines.admission import Admission
from dynpf_runtime.machines.effects import NEVER_NS, Count, Declare, Effect, Put, Subscribe, Tell, Watch
from dynpf_runtime.machines.events import Answered, Arrived, Counted, Event, RouterGone, Started, StopAsked, Token, Woke
from dynpf_runtime.machines.heartbeats import BEAT_NS, Heartbeats
from dynpf_runtime.machines.joining import Listening, Stage, Vacancy
from dynpf_runtime.machines.missing import MissingNotice
from dynpf_runtime.machines.refusals import Refusals, known_names
from dynpf_runtime.machines.rivals import Rivals
from dynpf_runtime.machines.roles import check_boot, check_named
from dynpf_runtime.machines.roster import Change, Operators, Roster, boot_of, follows, holder, next_start, was_before
from dynpf_runtime.plan import Plan

__all__ = ["Membership"]


class Membership:
    """The membership of the process ``name`` with its ``start`` in a run of ``plan``.

    ``prepare`` returns the effects once it is known that the process fits, before it is alive. The process that
    ``leads`` is running when all are ready; the others as soon as they are ready themselves, because then the first
    messages may come. A peer, or the router, that is gone is waited for ``patience_ns``. Who ``listens`` has a reason
    to think that it was there before. ``endpoint`` only appears in texts.
    """

    def __init__(
        self,
        name: str,
        plan: Plan,
        start: str,
        endpoint: str,
        prepare: Callable[[], Sequence[Effect]],
        *,
        leads: bool,
        patience_ns: int = 0,
        listens: bool = False,
    ) -> None:
        self.name, self.start = name, start
        self.recovers = patience_ns > 0
        self.before = ""  # the start from which this one has taken over
        self.successor = False  # whether it takes over from another start
        self.caught_up = True  # whether it has done again what that had done
        self.inherited = False  # whether that was gone with all others
        self.began = False  # whether the run had begun before this start
        self.peers = frozenset({*plan.graph.nodes, RECORDER} - {name})
        self.ticks = 0  # how many this process has ended
        self.kept: Mapping[str, int] = {}  # of the recorder: how many of each node are in its file
        self.recorded: Recorded | None = None
        self.over: Collection[str] = ()  # peers of whose last step this process knows: they may go
        self.stop_reason = ""
        self.leaving = False  # the run is over: peers may go
        self.pace: Pace | None = None  # of the source
        self.operators = Operators()
        self.wake_ns = NEVER_NS
        self.refusals = Refusals(known_names(plan))
        self.absence = Absence(patience_ns, self._tells)
        self._own = start
        self._starts = {start}  # all by which it has been known
        self._named: dict[str, str] = {}  # a peer -> the start by which it knows this process
        self._admission = Admission(name, plan.text, endpoint)
        self._endpoint, self._prepare = endpoint, prepare
        self._inherits = ""  # its last start
        self._leads, self._listens = leads, listens
        self._stage = Stage.ASKING
        self._stop_sent = False
        self._roster = Roster(self.peers)
        self.starts, self.boots = self._roster.starts, self._roster.boots  # of each peer; they change in place
        self.others = Roster({ROUTER})
        self._rivals = Rivals()
        self.heartbeats = Heartbeats()
        self._next_beat_ns = 0
        self._listening = Listening()
        self._vacancy = Vacancy(lingers=self.recovers)
        self._missing = MissingNotice()

    def inherit(self, starts: Mapping[str, str]) -> None:
        """Take over a run whose processes are all gone, by their last starts; heartbeats tell the peers of theirs."""
        self._inherits = starts[self.name]
        for peer in self.peers:
            self._roster.know(peer, starts[peer])

    @property
    def joined(self) -> bool:
        """Whether the process fits into the run, and has prepared for it."""
        return self._stage >= Stage.JOINING

    @property
    def alive(self) -> bool:
        """Whether its peers may know that it is there, and it has no rival that it should give way to."""
        return self._stage >= Stage.ALIVE

    @property
    def running(self) -> bool:
        """Whether the run may begin for this process."""
        return self._stage is Stage.RUNNING

    @property
    def present(self) -> set[str]:
        """The peers that are alive."""
        return self._roster.present

    @property
    def ready(self) -> set[str]:
        """The peers that have been ready."""
        return self._roster.ready

    def behind(self, peer: str) -> int:
        """Return how many ticks ``peer`` had ended at its last heartbeat."""
        return self.heartbeats.ticks(peer)

    def handle(self, event: Event, now_ns: int) -> Iterator[Effect]:
        """Yield the effects of an event; of arrivals, only heartbeats and control messages matter here.

        Raises UsageError if the process does not fit into the run, RunError when a peer or the router is gone for too
        long, and KeyboardInterrupt when this process is to end at once.
        """
        match event:
            case Started():
                yield self._admission.ask(now_ns)
            case Answered(payload):
                if self._admission.answered(payload, now_ns):
                    yield Count(f"{ALIVE}{self.name}/*")
            case Counted(key, keys):
                counted = self._counted_ready if key.startswith(READY) else self._counted_alive
                yield from counted(keys, now_ns)
            case Token():
                yield from self._token(event, now_ns)
            case Arrived(key) if key.startswith((BEAT, CONTROL)):
                yield from self._hear(event, now_ns)
            case StopAsked():
                yield from self._stop(event)
            case RouterGone() if not self.leaving:
                self.absence.lose_router(now_ns)
                self._admission.wait_for_router()
                self._listening.again(now_ns)
            case Woke():
                yield from self.absence.judge(now_ns, self.ticks, self._may_go)
        yield from self._look(now_ns)
        if self.joined and now_ns >= self._next_beat_ns:
            yield from self._beat(now_ns)
        if Stage.ALIVE <= self._stage < Stage.RUNNING:
            yield from self._assemble(now_ns)
        elif self.running and not self.ticks and self.name == RECORDER:  # who left before it was ready may be replaced
            yield from self._missing.tell("waiting for", self.peers - self.starts.keys(), now_ns)
        self.wake_ns = self._due_ns(now_ns)

    def _look(self, now_ns: int) -> Iterator[Effect]:
        """Do what is due while this process is not alive: ask again, look again, or stop to listen."""
        if self._stage is Stage.ASKING and now_ns >= self._admission.wake_ns:
            yield self._admission.ask(now_ns)
        if self._stage is Stage.ASKING and self._vacancy.due(now_ns):
            yield Count(f"{ALIVE}{self.name}/*")
        if self._stage is Stage.LISTENING and now_ns >= self._listening.until_ns:
            yield from self._join()

    def _due_ns(self, now_ns: int) -> int:
        if self._stage is Stage.ASKING:
            return min(self._admission.wake_ns, self._vacancy.look_at_ns)
        if self._stage is Stage.LISTENING:
            return self._listening.until_ns
        due_ns = self._next_beat_ns
        if self._stage < Stage.RUNNING and self._missing.wake_ns > now_ns:
            due_ns = min(due_ns, self._missing.wake_ns)
        return min(due_ns, self.absence.due_ns())

    def _counted_ready(self, keys: Sequence[str], now_ns: int) -> Iterator[Effect]:
        """Listen to those who are ready, or become alive if nobody is."""
        if self._stage is not Stage.LISTENING:
            return  # a heartbeat has already told from whom it takes over
        if any(holder(Token(key, True))[0] in self.peers for key in keys) or (self._listens and not self._inherits):
            self._listening.begin(now_ns)
            return
        self.before = self._inherits
        self.successor = self.inherited = self.absence.resumed = bool(self._inherits)
        yield from self._join()

    def _counted_alive(self, keys: Sequence[str], now_ns: int) -> Iterator[Effect]:
        """Become alive if the name is free; then look again, because a rival may have joined at the same moment.

        Each of two rivals declares itself before it looks again, so at least one sees the other.
        """
        others = [start for key in keys if (start := key.rpartition("/")[2]) not in self._starts]
        if self._stage is Stage.ASKING:
            if others:
                if self._vacancy.is_over(now_ns):
                    raise self._taken(others[0])
            elif self.recovers:
                self._stage = Stage.LISTENING
                yield Count(f"{READY}**")  # before it watches them, or tokens on their way may be left out
                yield from _LISTEN
            else:
                yield from self._join()
            return
        for start in others:
            self._rival(start, ready=False, present=True)
        self._stage = max(self._stage, Stage.ALIVE)
        self._missing.after(now_ns)

    def _join(self) -> Iterator[Effect]:
        """Become alive."""
        listening = self._stage is Stage.LISTENING
        self._stage = Stage.JOINING
        yield from self._prepare()
        if not listening:
            yield from _LISTEN
        yield Declare(f"{ALIVE}{self.name}/{self.start}")
        yield Count(f"{ALIVE}{self.name}/*")

    def _succeed(self, before: str, starts: Mapping[str, str]) -> Iterator[Effect]:
        """Take over from the start ``before``, if nobody has done that and this process has not begun on its own.

        Who knows of it knows by which ``starts`` the peers have begun the run; others may have come lately, as this
        process has.
        """
        if before in self._starts or follows(self.start, before) or self._stage is Stage.ASKING:
            return
        other = boot_of(before) != boot_of(self.start)
        if other and self.ticks:
            return  # it speaks of another run
        self.before, self.start = before, next_start(before, self._own)
        self._starts.add(self.start)
        if other:
            self.successor, self.caught_up, self.absence.resumed = True, False, True
            for peer in self.peers & starts.keys():
                self._roster.correct(peer, starts[peer])
        if self._stage is Stage.LISTENING:
            yield from self._join()
            return
        yield Declare(f"{ALIVE}{self.name}/{self.start}")
        if other:
            self._stage = min(self._stage, Stage.ALIVE)
        elif self._stage >= Stage.READY:
            yield Declare(f"{READY}{self.name}/{self.start}")

    def _rival(self, start: str, *, ready: bool, present: bool) -> None:
        """Give way to a rival, or have it give way: by who of them is ready."""
        if self._stage < Stage.READY:
            if self._rivals.take(start, self.start, ready=ready, present=present):
                raise self._taken(start)
        elif present and self.absence.was_cut and follows(start, self.start):
            raise BrokenOffError(f"another {self.name} has taken over, since this one was cut off")

    def _taken(self, start: str) -> UsageError:
        return UsageError(f"{self.name} already runs at {self._endpoint} (boot {start}); stop it first")

    def _assemble(self, now_ns: int) -> Iterator[Effect]:
        """Become ready when every peer is alive, and begin; report missing peers if it takes long.

        Who takes over is ready when it has caught up, and waits for nobody if the run had begun.
        """
        if self._stage is Stage.ALIVE:
            missing = frozenset() if self.successor else self.peers - self._roster.present
            if missing or self._rivals.present or not self.caught_up:
                yield from self._missing.tell("waiting for", missing, now_ns)
                return
            yield Declare(f"{READY}{self.name}/{self.start}")
            self._stage = Stage.READY
            self._missing.after(now_ns)
            yield from self._beat(now_ns)  # so that the source knows at once that it is known
        missing = self.peers - self._roster.ready
        if self._leads and missing and not self.began:
            yield from self._missing.tell("waiting until ready:", missing, now_ns)
        elif not (self._leads and self.recovers and not self.began and self.strange):
            self._stage = Stage.RUNNING

    @property
    def strange(self) -> bool:
        """Whether a peer has not said that it knows this start: it may still have a predecessor in mind."""
        return any(self._named.get(peer) not in self._starts for peer in self.peers)

    def _beat(self, now_ns: int) -> Iterator[Effect]:
        self._next_beat_ns = now_ns + BEAT_NS
        beat = Beat(self.name, self.start, self.ticks, kept=dict(self.kept), starts=self._known(), pace=self.pace)
        yield Put(f"{BEAT}{self.name}", encode_control(beat))
        if not self.leaving:
            patience_ns = self.absence.patience_ns
            for text in self.heartbeats.look({**self.starts, **self.others.starts}, now_ns, patience_ns):
                if self.name == RECORDER:  # once is enough, and it is never in a step itself
                    yield Tell(text)

    def _known(self) -> dict[str, str]:
        """Return the starts to tell of: before this process is ready, those from which others have to take over."""
        if self._stage >= Stage.READY:
            return {**self.starts, self.name: self.start}
        return self._roster.due if self.alive and not self.successor else {}

    def _token(self, token: Token, now_ns: int) -> Iterator[Effect]:
        node, start, ready = holder(token)
        if token.present:
            self.absence.find_router()
        if node == self.name and start not in self._starts:
            self._rival(start, ready=ready, present=token.present)
        elif node == OPERATOR:
            self.operators.take(token)
        elif node in self.others.names:
            self.others.take(token)
            if node == ROUTER and token.present:
                self._listening.again(now_ns)
        elif node in self.peers:
            change = self._roster.take(token, begun=self.ticks > 0)
            if change is Change.SECOND and not self._learns(node):
                yield Tell(f"a second {node} (boot {start}) is refused; this run's is {self.starts[node]}")
            elif change is Change.GONE and not self._may_go(node):
                self.absence.left(node, now_ns)
            elif change is Change.BACK or (change is Change.ANOTHER and self._stage >= Stage.READY):
                self.absence.back(node)

    def _learns(self, peer: str) -> bool:
        """Return whether a peer may not know yet that it takes over, as this process does: both were lost."""
        return self.successor and peer in self.peers - self.present

    def _may_go(self, node: str) -> bool:
        return self.recorded is not None if node == RECORDER else self.leaving or node in self.over

    def _tells(self, peer: str) -> bool:
        return self.name == RECORDER or (peer == RECORDER and self._leads)

    def _hear(self, arrived: Arrived, now_ns: int) -> Iterator[Effect]:
        key = arrived.key
        try:
            if key.startswith(BEAT):
                yield from self._take_beat(check_named(arrived, BEAT, Beat), now_ns)
            elif key == RECORDED:
                self._take_recorded(decode_control(arrived.payload, Recorded))
            elif key.startswith(STOP):
                self._take_stop(check_named(arrived, STOP, Stop))
        except ProtocolError as error:
            text = self.refusals.note(key, error, now_ns)
            if text is not None:
                yield Tell(text)

    def _take_beat(self, beat: Beat, now_ns: int) -> Iterator[Effect]:
        known = self.starts | self.others.starts
        if beat.node not in known or follows(beat.boot, known[beat.node]):  # its first beat may come before its token
            return
        if was_before(beat.boot, known[beat.node]) or was_before(known[beat.node], beat.boot):
            return  # it had not taken over when it said this; or it has, and this process does not know from whom
        if self._learns(beat.node):
            return
        check_boot(beat.node, beat.boot, known)
        self.heartbeats.take(beat, now_ns)
        if beat.node not in self.peers or not self.recovers or not beat.starts:
            return
        if (named := beat.starts.get(self.name)) is not None:
            self._named[beat.node] = named
            yield from self._succeed(named, beat.starts)
        if self.successor:
            for peer in self.peers & beat.starts.keys():
                self._roster.know(peer, beat.starts[peer])

    def _take_recorded(self, recorded: Recorded) -> None:
        """Believe the recorder's word if it fits: complete only at the end; broken off, if the recorder then goes."""
        if self.name == RECORDER:
            if not self.leaving:
                raise UnknownSenderError("it comes in this process's own name, and this process has not sent it")
            return
        check_boot(RECORDER, recorded.boot, self.starts)
        if self.leaving or not self.caught_up:
            self.recorded = recorded
        elif recorded.complete:
            raise OrderError("the run is not over: its last tick is still to come")
        else:
            self.absence.closed_early = printable(recorded.reason) or "no reason was given"

    def _take_stop(self, stop: Stop) -> None:
        if stop.node != OPERATOR or stop.boot not in self.operators:
            check_boot(stop.node, stop.boot, {**self.starts, **self.others.starts, self.name: self.start})
        if stop.node == self.name and not self._stop_sent:
            raise UnknownSenderError("it comes in this process's own name, and this process has not sent it")
        self.stop_reason = printable(stop.reason, 200)

    def _stop(self, event: StopAsked) -> Iterator[Effect]:
        if event.at_once or not self.running:
            raise KeyboardInterrupt(event.reason if self.running else "")
        if self.recovers:  # who is gone need not come back
            self.absence.stop_waiting()
            yield from self.absence.judge(NEVER_NS, self.ticks, self._may_go)
        if not self._stop_sent:
            self._stop_sent = True
            self.stop_reason = self.stop_reason or event.reason
            yield Put(f"{STOP}{self.name}", encode_control(Stop(self.name, self.start, event.reason)))


_LISTEN = (Subscribe(f"{CONTROL}**"), Subscribe(f"{BEAT}**"), Watch(f"{ALIVE}**"), Watch(f"{READY}**"))
