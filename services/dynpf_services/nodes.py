"""Nodes of one's own: what a class has to have so that a scenario can name it, ``kind = "package.module:Name"``.

A node is a frozen struct: its fields are its parameters, typed and checked as all of a scenario. What it remembers from
step to step is its State, which steps are given and return; so it can be taken out, put back and digested as it is.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar

import msgspec
from dynpf_protocol.messages import Message, RobotState
from dynpf_protocol.topics import Topic
from dynpf_runtime.node import Received
from msgspec import Meta

from dynpf.rng import Draws, generator

__all__ = ["Moment", "NoState", "Node", "Sensor"]

M = TypeVar("M", bound=Message)


class NoState(NamedTuple):
    """The state of a node that remembers nothing."""


class Moment(NamedTuple):
    """What a step is given: its number, the tick, the logical time, and its inputs in order.

    ``fact`` gives a table that the run's nodes share, such as "map" or "landmarks"; None where the run has none.
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
        """Return the message of a type with the latest stamp, None where there is none."""
        found = [
            (received.stamp_ns, received.message) for received in self.inputs if isinstance(received.message, kind)
        ]
        return max(found, key=lambda pair: pair[0])[1] if found else None

    def draws(self, purpose: str = "") -> Draws:
        """Return this step's random numbers for one purpose: the same for the same seed, node and step."""
        return generator(self.seed, self.node, self.number, purpose)


Output = Message | tuple[str, Message]


class Node(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A node of one's own.

    ``reads`` names topics, or types of messages: of a type, all topics of the same robot that carry it. ``writes`` has
    the type of each topic that it writes to; a name without a slash is the node's own, ``alarm`` of a node ``guard``
    being ``guard/alarm``. State is a NamedTuple of plain values, messages and NumPy arrays, with a default for each.
    """

    reads: ClassVar[Sequence[str | type[Message]]] = ()
    writes: ClassVar[Mapping[str, type[Message] | Topic]] = {}
    State: ClassVar[type] = NoState

    @abstractmethod
    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Output]] | tuple[Any, Iterable[Output], bool]:
        """Return the state after the step and what the node says: messages, with their topics where types do not tell.

        A pure function of its arguments: no clock, no file, no random numbers but ``moment.draws()``. The source of a
        run may return, as a third, whether this tick is the last.
        """


class Sensor(Node, frozen=True, kw_only=True):
    """A simulated sensor: at each new true state of the robot, or at every so many, one reading on one topic.

    ``topic`` names it and ``message`` is its type; ``sense`` makes it.
    """

    topic: ClassVar[str]
    message: ClassVar[type[Message]]
    reads: ClassVar[Sequence[str | type[Message]]] = ("truth/robot",)

    every: Annotated[int, Meta(ge=1)] = 1  # true states between readings

    class State(NamedTuple):
        states: int = 0  # seen so far

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "topic" in vars(cls):
            cls.writes = {cls.topic: cls.message}

    @abstractmethod
    def sense(self, truth: RobotState, draws: Draws) -> Message | None:
        """Return the reading at a true state, None for no reading; its random numbers come from ``draws``."""

    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Output]]:
        """Read the newest true state, if there is a new one."""
        truth = moment.newest(RobotState)
        if truth is None:
            return state, ()
        reading = self.sense(truth, moment.draws()) if state.states % self.every == 0 else None
        return state._replace(states=state.states + 1), () if reading is None else (reading,)
