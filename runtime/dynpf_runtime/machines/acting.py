"""Acting: what an operator asks of the source of a run: acts on a simulated world, which enter it at the next tick,
and the pace at which its ticks follow each other.

An act becomes an input of the run: the source's host publishes it, and its journal has it. The pace is none, for it
changes when ticks are made, and nothing of what they do.
"""

from collections import defaultdict, deque
from typing import NamedTuple

from dynpf_protocol.codec import decode
from dynpf_protocol.control import Act, Pace
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import OrderError, TooLargeError, UnknownSenderError, UnknownTopicError
from dynpf_protocol.keys import ACT, DATA, OPERATOR, topic_of
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import is_act

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.roles import check_named
from dynpf_runtime.machines.roster import Operators
from dynpf_runtime.machines.turns import Turn
from dynpf_runtime.node import Received, Refusing

__all__ = ["Acting", "Entered", "told"]

MOST_WAITING = 64
"""How many acts may wait for the next tick."""


class Entered(NamedTuple):
    """The acts that enter a run in a tick, those among them that its source reads, and why others do not."""

    sent: tuple[Sent, ...]
    read: tuple[Received, ...]
    refused: tuple[str, ...]


class Acting:
    """The acts on the source of a run with ``graph``, by ``operators`` who are there; it begins at a ``rate``.

    A live robot's run is not ``paced`` by anybody else.
    """

    def __init__(self, graph: Graph, operators: Operators, rate: float | None, *, paced: bool = True) -> None:
        self._topics = graph.topics
        self._acts = graph.acts
        self._operators = operators
        self._waiting: deque[tuple[str, Message]] = deque()
        self._numbers: dict[str, int] = {}  # the last of each start
        self._recalled: defaultdict[int, list[tuple[str, Message]]] = defaultdict(list)  # by tick
        self.pace = Pace(rate=rate or 0.0)
        self._paced = paced
        self._until = 0  # when paused: ticks to be made

    @property
    def paused(self) -> bool:
        """Whether an operator has paused the run."""
        return self.pace.paused

    def holds(self, ticks: int) -> bool:
        """Return whether no tick is to follow on so many."""
        return self.pace.paused and ticks >= self._until

    def hear(self, arrived: Arrived, ticks: int) -> Pace | None:
        """Take what an operator asks for after so many ticks; return the new pace if it is that.

        Raises ProtocolError for what nobody may ask for, or cannot be.
        """
        act = check_named(arrived, ACT, Act)
        if act.node != OPERATOR or act.boot not in self._operators:
            raise UnknownSenderError(f"{act.node!r}, boot {act.boot!r}, is no operator who is there")
        if act.number <= self._numbers.get(act.boot, -1):
            raise OrderError(f"request {act.number} of the operator again")
        self._numbers = {boot: last for boot, last in self._numbers.items() if boot in self._operators}
        self._numbers[act.boot] = act.number
        if act.pace is not None and not self._paced:
            raise OrderError("a live robot sets the pace of this run")
        if act.pace is not None:
            self._until = ticks + act.pace.steps
            return act.pace
        if act.topic not in self._acts:
            listed = ", ".join(sorted(self._acts)) or "none"
            raise UnknownTopicError(f"{act.topic!r}: no node of this run takes such acts; it takes {listed}")
        if len(self._waiting) >= MOST_WAITING:
            raise TooLargeError(f"{MOST_WAITING} acts wait for the next tick already")
        self._waiting.append((act.topic, decode(act.topic, act.payload, self._topics)))
        return None

    def recall(self, arrived: Arrived, node: str) -> bool:
        """Take an act that an earlier start of this ``node`` has let in; return False for another message."""
        if not arrived.key.startswith(DATA) or not is_act(topic := topic_of(arrived.key)[0]):
            return False
        envelope = decode_envelope(arrived.attachment)
        if envelope.node != node:
            return False
        self._recalled[envelope.tick].append((topic, decode(topic, arrived.payload, self._topics)))
        return True

    def enter(self, executor: Executor, turn: Turn, wall_ns: int, *, again: bool) -> Entered:
        """Return what enters in a turn, numbered by the source's ``executor``.

        One that is made ``again`` has the acts that it had, and no others.
        """
        for fed in turn.fed:
            if is_act(fed.topic):  # of a step that is made again by its journal entry
                executor.number_from(fed.topic, fed.envelope.sequence + 1)
        tick, stamp_ns = turn.ready.tick, turn.stamp_ns
        found = self._recalled.pop(tick, None)
        refused: list[str] = []
        if found is None:
            found = []
            while self._waiting and not again:
                topic, message = self._waiting.popleft()
                if why := _refused(executor, topic, message):
                    refused.append(f"{topic}: {why}")
                else:
                    found.append((topic, message))
        return Entered(*executor.let_in(found, tick, stamp_ns, wall_ns), tuple(refused))


def _refused(executor: Executor, topic: str, message: Message) -> str:
    """Return why the source's node does not take an act, "" if it does, or if the act is for another node."""
    own = executor.spec.reads.get(topic)
    if own is None or not isinstance(executor.node, Refusing):
        return ""
    try:
        return executor.node.refuses(message)
    except Exception as error:  # a run does not end because a person has asked for something
        return f"the node cannot tell whether it can be done: {type(error).__name__}: {error}"


def told(pace: Pace) -> str:
    """Return a pace in words."""
    if pace.paused:
        return "the operator has paused the run"
    return f"the operator lets the run go on, {f'at {pace.rate:g} x' if pace.rate else 'as fast as it goes'}"
