"""User nodes: the base classes of nodes that a scenario names as ``kind = "package.module:Name"``.

A node is a frozen struct: its fields are its parameters, typed and checked like the rest of a scenario. Its memory from
step to step is its State, which each step takes and returns; so it can be saved, restored and digested.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

import msgspec
from dynpf_protocol.messages import Message, RobotState
from dynpf_protocol.topics import Topic
from dynpf_runtime.node import Received

from dynpf.rng import Draws, generator
from dynpf.types import Count

__all__ = ["Moment", "NoState", "Node", "Sensor"]

M = TypeVar("M", bound=Message)


class NoState(NamedTuple):
    """The state of a node without memory."""


class Moment(NamedTuple):
    """The arguments of a step: its number, the tick, the logical time, and its inputs in order.

    ``fact`` returns a table that the run's nodes share, such as "map" or "landmarks"; None if the run has none.
    """

    number: int
    tick: int
    stamp_ns: int
    inputs: tuple[Received, ...]
    node: str
    seed: int
    fact: Callable[[str], Any]

    def all(self, kind: type[M]) -> list[M]:
        """Return the messages of a type among the inputs, in order."""
        return [received.message for received in self.inputs if isinstance(received.message, kind)]

    def newest(self, kind: type[M]) -> M | None:
        """Return the message of a type with the latest stamp, None if there is none."""
        found = [
            (received.stamp_ns, received.message) for received in self.inputs if isinstance(received.message, kind)
        ]
        return max(found, key=lambda pair: pair[0])[1] if found else None

    def draws(self, purpose: str = "") -> Draws:
        """Return this step's random numbers for a purpose; they depend only on seed, node, step and purpose."""
        return generator(self.seed, self.node, self.number, purpose)


Output = Message | tuple[str, Message]


class Node(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A user node.

    ``reads`` lists topics, or message types, which stand for all topics of the same robot that carry them. ``writes``
    has the type of each topic that the node writes; a name without a slash is the node's own: ``alarm`` of a node
    ``guard`` is the topic ``guard/alarm``. State is a NamedTuple of plain values, messages and NumPy arrays, each with
    a default.
    """

    reads: ClassVar[Sequence[str | type[Message]]] = ()
    writes: ClassVar[Mapping[str, type[Message] | Topic]] = {}
    State: ClassVar[type] = NoState

    @abstractmethod
    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Output]] | tuple[Any, Iterable[Output], bool]:
        """Return the state after the step, and messages: each alone, or with its topic if its type has several.

        It must be a pure function of its arguments: no clock, no file, no random numbers but ``moment.draws()``. The
        source of a run may return, as a third value, whether this tick is the last.
        """


class Sensor(Node, frozen=True, kw_only=True):
    """A simulated sensor: one reading on one topic at every ``every``-th new true state of the robot.

    ``topic`` and ``message`` are the reading's topic and type; ``sense`` makes it.
    """

    topic: ClassVar[str]
    message: ClassVar[type[Message]]
    reads: ClassVar[Sequence[str | type[Message]]] = ("truth/robot",)

    every: Count = 1  # true states between readings

    class State(NamedTuple):
        """What it remembers."""

        states: int = 0  # true states so far

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "topic" in vars(cls):
            cls.writes = {cls.topic: cls.message}

    @abstractmethod
    def sense(self, truth: RobotState, draws: Draws) -> Message | None:
        """Return the reading at a true state, None for no reading, with random numbers from ``draws`` alone."""

    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Output]]:
        """Read the newest true state, if there is a new one."""
        truth = moment.newest(RobotState)
        if truth is None:
            return state, ()
        reading = self.sense(truth, moment.draws()) if state.states % self.every == 0 else None
        return state._replace(states=state.states + 1), () if reading is None else (reading,)
