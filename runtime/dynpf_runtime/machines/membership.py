"""Membership: how a process joins a run, knows its peers, sends heartbeats, and notices that a peer is gone.

A process joins in two steps: *alive* when its subscriptions are in place, *ready* when it has seen every peer alive.
The source begins when all are ready, so no message can precede its subscribers, and every sender is known by its boot.
"""

from collections import deque
from collections.abc import Collection, Iterator, Sequence
from enum import IntEnum

from dynpf_protocol.control import Beat, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import (
    BrokenOffError,
    OrderError,
    ProtocolError,
    RunError,
    UnknownSenderError,
    UsageError,
)
from dynpf_protocol.keys import ALIVE, BEAT, CONTROL, OPERATOR, READY, RECORDED, RECORDER, ROUTER, SCENARIO, STOP
from dynpf_protocol.printable import printable

from dynpf_runtime.machines.agreement import first_difference
from dynpf_runtime.machines.effects import NEVER_NS, Ask, Count, Declare, Effect, Put, Subscribe, Tell, Watch
from dynpf_runtime.machines.events import Answered, Arrived, Counted, Event, RouterGone, Started, StopAsked, Token, Woke
from dynpf_runtime.machines.heartbeats import BEAT_NS, Heartbeats
from dynpf_runtime.machines.refusals import Refusals, known_names
from dynpf_runtime.machines.roles import check_boot, check_named
from dynpf_runtime.machines.roster import MOST_STARTS, Change, Roster, holder
from dynpf_runtime.plan import Plan

__all__ = ["LAST_WORD_NS", "SURE_NS", "Membership"]

SURE_NS = 50_000_000
"""How long to wait after a peer's token disappears: if the router is gone, the peers' tokens disappear first."""

LAST_WORD_NS = 500_000_000
"""Tokens and messages come on ways of their own: the recorder's last word may come after its token has gone."""

_ANSWER_NS = 5_000_000_000
_ASK_AGAIN_NS = 20_000_000  # Zenoh reports at once that no one answers yet
_DIFFERS_NS = 3_000_000_000  # how long another scenario has to be the answer, and ours not among the answers
_PATIENCE_NS = 1_000_000_000  # after that a notice lists the missing peers

_ROUTER_GONE = "the router is gone or hangs; the run cannot go on"


class _Stage(IntEnum):
    ASKING = 0  # whether its scenario is the router's, and its name is free
    JOINING = 1  # alive, but a rival of the same name may have joined at the same moment
    ALIVE = 2
    READY = 3  # it leads the run, and waits until all are ready
    RUNNING = 4


class Membership:
    """The membership of the process ``name`` with its ``boot`` in a run of ``plan``.

    ``prepare`` are the effects once it is known that the process fits, before it is alive. The process that ``leads``
    is running when all are ready; the others as soon as they are ready themselves, because then the first messages may
    come. ``endpoint`` only appears in texts.
    """

    def __init__(
        self, name: str, plan: Plan, boot: str, endpoint: str, prepare: Sequence[Effect], *, leads: bool
    ) -> None:
        self.name = name
        self.boot = boot
        self.peers = frozenset({*plan.graph.nodes, RECORDER} - {name})
        self.ticks = 0  # how many this process has ended
        self.recorded: Recorded | None = None
        self.over: Collection[str] = ()  # peers of whose last step this process knows: they may go
        self._closed_early = ""
        self.stop_reason = ""
        self.leaving = False  # the run is over: peers may go
        self.wake_ns = NEVER_NS
        self.refusals = Refusals(known_names(plan))
        self._text = plan.text
        self._endpoint = endpoint
        self._prepare = prepare
        self._leads = leads
        self._stage = _Stage.ASKING
        self._stop_sent = False
        self._roster = Roster(self.peers)
        self._others = Roster({ROUTER, OPERATOR})
        self._rivals: set[str] = set()
        self._ready_rivals: deque[str] = deque(maxlen=MOST_STARTS)
        self._heartbeats = Heartbeats()
        self._next_beat_ns = 0
        self._ask_at_ns = self._ask_until_ns = self._differ_at_ns = NEVER_NS
        self._notify_at_ns = 0
        self._notified: set[str] = set()
        self._suspect: tuple[str, int] | None = None

    @property
    def joined(self) -> bool:
        """Whether the process fits into the run, and has prepared for it."""
        return self._stage is not _Stage.ASKING

    @property
    def running(self) -> bool:
        """Whether the run may begin for this process."""
        return self._stage is _Stage.RUNNING

    @property
    def boots(self) -> dict[str, str]:
        """The boot of each present peer; changes in place."""
        return self._roster.boots

    @property
    def present(self) -> set[str]:
        """The peers that are alive."""
        return self._roster.present

    def behind(self, peer: str) -> int:
        """Return how many ticks ``peer`` had ended at its last heartbeat."""
        return self._heartbeats.ticks(peer)

    def handle(self, event: Event, now_ns: int) -> Iterator[Effect]:
        """Yield the effects of an event; of arrivals, only heartbeats and control messages matter here.

        Raises UsageError if the process does not fit into the run, RunError when a peer or the router is gone, and
        KeyboardInterrupt when this process is to end at once.
        """
        match event:
            case Started():
                self._ask_until_ns = now_ns + _ANSWER_NS
                yield Ask(SCENARIO, self._text.encode())
            case Answered(payload):
                yield from self._answered(payload, now_ns)
            case Counted(keys):
                yield from self._counted(keys, now_ns)
            case Token():
                yield from self._token(event, now_ns)
            case Arrived(key) if key.startswith((BEAT, CONTROL)):
                yield from self._hear(event, now_ns)
            case StopAsked():
                yield from self._stop(event)
            case RouterGone():
                if not self.leaving:
                    raise BrokenOffError(_ROUTER_GONE)
            case Woke():
                self._judge(now_ns)
        if self._stage is _Stage.ASKING and now_ns >= self._ask_at_ns:
            self._ask_at_ns = NEVER_NS
            yield Ask(SCENARIO, self._text.encode())
        if self._stage >= _Stage.JOINING and now_ns >= self._next_beat_ns:
            yield from self._beat(now_ns)
        if _Stage.ALIVE <= self._stage < _Stage.RUNNING:
            yield from self._assemble(now_ns)
        self.wake_ns = self._due_ns(now_ns)

    def _due_ns(self, now_ns: int) -> int:
        if self._stage is _Stage.ASKING:
            return self._ask_at_ns
        due_ns = self._next_beat_ns
        if self._stage < _Stage.RUNNING and self._notify_at_ns > now_ns:
            due_ns = min(due_ns, self._notify_at_ns)
        return due_ns if self._suspect is None else min(due_ns, self._suspect[1])

    def _answered(self, theirs: bytes | None, now_ns: int) -> Iterator[Effect]:
        router = f"the router at {self._endpoint}"
        if theirs is None:
            if now_ns > self._ask_until_ns:
                raise RunError(
                    f"{router} does not say which scenario it runs; is it a dynpf router, and is {self.name}'s key "
                    "not revoked?"
                )
            self._ask_at_ns = now_ns + _ASK_AGAIN_NS
            return
        if theirs != self._text.encode() and now_ns < self._differ_at_ns:
            # It may be a stranger's, who was there before the router had begun to answer.
            self._differ_at_ns = min(self._differ_at_ns, now_ns + _DIFFERS_NS)
            self._ask_at_ns = now_ns + _ASK_AGAIN_NS
            return
        try:
            difference = first_difference(self._text, theirs.decode())
        except (ValueError, RecursionError) as error:  # the text is only compared: user code in it is never imported
            reason = printable(str(error))
            raise RunError(f"{router} sent a scenario that cannot be read: {reason}") from error
        if difference is not None:
            key, here, there = difference
            raise UsageError(
                f"refused: this scenario differs from the router's in {printable(key)}: "
                f"here {printable(repr(here))}, there {printable(repr(there))}"
            )
        yield Count(f"{ALIVE}{self.name}/*")

    def _counted(self, keys: Sequence[str], now_ns: int) -> Iterator[Effect]:
        """Become alive if the name is free; then look again, because a rival may have joined at the same moment.

        Each of two rivals declares itself before it looks again, so at least one sees the other.
        """
        others = [key.rpartition("/")[2] for key in keys if key != f"{ALIVE}{self.name}/{self.boot}"]
        if self._stage is _Stage.ASKING:
            if others:
                raise self._taken(others[0])
            self._stage = _Stage.JOINING
            yield from self._prepare
            yield from (Subscribe(f"{CONTROL}**"), Subscribe(f"{BEAT}**"), Watch(f"{ALIVE}**"), Watch(f"{READY}**"))
            yield Declare(f"{ALIVE}{self.name}/{self.boot}")
            yield Count(f"{ALIVE}{self.name}/*")
            return
        for boot in others:
            self._rival(boot, ready=False, present=True)
        self._stage = _Stage.ALIVE
        self._notify_at_ns = now_ns + _PATIENCE_NS

    def _rival(self, boot: str, *, ready: bool, present: bool) -> None:
        """Give way to a rival of the same name that is ready or has the smaller boot, so that exactly one stays."""
        if self._stage >= _Stage.READY:
            return  # the rival gives way
        if not present:
            if not ready:
                self._rivals.discard(boot)
            return
        if ready:
            self._ready_rivals.append(boot)  # its token of life may still come, by another subscription
        else:
            self._rivals.add(boot)
        if boot in self._rivals and (boot in self._ready_rivals or boot < self.boot):
            raise self._taken(boot)

    def _taken(self, boot: str) -> UsageError:
        return UsageError(f"{self.name} already runs at {self._endpoint} (boot {boot}); stop it first")

    def _assemble(self, now_ns: int) -> Iterator[Effect]:
        """Become ready when every peer is alive, and begin; report missing peers if it takes long."""
        if self._stage is _Stage.ALIVE:
            missing = self.peers - self.boots.keys()
            if missing or self._rivals:
                yield from self._notify_missing("waiting for", missing, now_ns)
                return
            yield Declare(f"{READY}{self.name}/{self.boot}")
            self._stage = _Stage.READY
            self._notified, self._notify_at_ns = set(), now_ns + _PATIENCE_NS
        missing = self.peers - self._roster.ready
        if self._leads and missing:
            yield from self._notify_missing("waiting until ready:", missing, now_ns)
        else:
            self._stage = _Stage.RUNNING

    def _notify_missing(self, what: str, names: set[str] | frozenset[str], now_ns: int) -> Iterator[Effect]:
        if names and now_ns >= self._notify_at_ns and names != self._notified:
            self._notified = set(names)
            yield Tell(f"{what} {', '.join(sorted(names))}")

    def _beat(self, now_ns: int) -> Iterator[Effect]:
        self._next_beat_ns = now_ns + BEAT_NS
        yield Put(f"{BEAT}{self.name}", encode_control(Beat(self.name, self.boot, self.ticks)))
        if not self.leaving:
            for text in self._heartbeats.look({**self.boots, **self._others.boots}, now_ns):
                if self.name == RECORDER:  # once is enough, and it is never in a step itself
                    yield Tell(text)

    def _token(self, token: Token, now_ns: int) -> Iterator[Effect]:
        node, boot, ready = holder(token)
        if node == self.name and boot != self.boot:
            self._rival(boot, ready=ready, present=token.present)
        elif node in self._others.names:
            self._others.take(token)
        elif node in self.peers:
            change = self._roster.take(token)
            if change is Change.SECOND:
                yield Tell(f"a second {node} (boot {boot}) is refused; this run's is {self.boots[node]}")
            elif change is Change.GONE and self._suspect is None and not self._may_go(node):
                self._suspect = node, now_ns + (LAST_WORD_NS if node == RECORDER else SURE_NS)

    def _may_go(self, node: str) -> bool:
        return self.recorded is not None if node == RECORDER else self.leaving or node in self.over

    def _judge(self, now_ns: int) -> None:
        """Raise BrokenOffError for a peer whose token is gone, once it is clear that the router is not."""
        if self._suspect is None or now_ns < self._suspect[1]:
            return
        node, _ = self._suspect
        self._suspect = None
        if node == RECORDER and self._closed_early:
            raise BrokenOffError(f"the recorder has closed the recording: {self._closed_early}")
        if not self._may_go(node):
            raise BrokenOffError(
                f"{node} is gone (killed, crashed, stopped or cut off) after tick {self.ticks}; the run cannot go on"
            )

    def _hear(self, arrived: Arrived, now_ns: int) -> Iterator[Effect]:
        key = arrived.key
        try:
            if key.startswith(BEAT):
                beat = check_named(arrived, BEAT, Beat)
                known = self.boots | self._others.boots
                if beat.node in known:  # its first beat may come before its token
                    check_boot(beat.node, beat.boot, known)
                    self._heartbeats.take(beat, now_ns)
            elif key == RECORDED:
                self._take_recorded(decode_control(arrived.payload, Recorded))
            elif key.startswith(STOP):
                self._take_stop(check_named(arrived, STOP, Stop))
        except ProtocolError as error:
            text = self.refusals.note(key, error, now_ns)
            if text is not None:
                yield Tell(text)

    def _take_recorded(self, recorded: Recorded) -> None:
        """Believe the recorder's word if it fits: complete only at the end; broken off, if the recorder then goes."""
        if self.name == RECORDER:
            if not self.leaving:
                raise UnknownSenderError("it comes in this process's own name, and this process has not sent it")
            return
        check_boot(RECORDER, recorded.boot, self.boots)
        if self.leaving:
            self.recorded = recorded
        elif recorded.complete:
            raise OrderError("the run is not over: its last tick is still to come")
        else:
            self._closed_early = printable(recorded.reason) or "no reason was given"

    def _take_stop(self, stop: Stop) -> None:
        check_boot(stop.node, stop.boot, {**self.boots, **self._others.boots, self.name: self.boot})
        if stop.node == self.name and not self._stop_sent:
            raise UnknownSenderError("it comes in this process's own name, and this process has not sent it")
        self.stop_reason = printable(stop.reason, 200)

    def _stop(self, event: StopAsked) -> Iterator[Effect]:
        if event.at_once or not self.running:
            raise KeyboardInterrupt(event.reason if self.running else "")
        if not self._stop_sent:
            self._stop_sent = True
            self.stop_reason = self.stop_reason or event.reason
            yield Put(f"{STOP}{self.name}", encode_control(Stop(self.name, self.boot, event.reason)))
