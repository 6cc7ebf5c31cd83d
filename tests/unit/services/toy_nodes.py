"""Toy nodes for the tests of what surrounds a node."""

from collections.abc import Callable, Iterable

from dynpf_protocol.messages import Command, Message, Odometry
from dynpf_runtime.node import Output, Received, Result, State, Step


class ToyNode:
    """Does in a step what it is told to, and remembers the steps."""

    def __init__(
        self,
        name: str,
        reads: Iterable[str] = (),
        writes: Iterable[str] = (),
        act: Callable[[Step], Result] = lambda _: Result(),
    ) -> None:
        self.name = name
        self.reads = frozenset(reads)
        self.writes = frozenset(writes)
        self.steps: list[Step] = []
        self._act = act

    def step(self, step: Step) -> Result:
        self.steps.append(step)
        return self._act(step)

    def freeze(self) -> State:
        return {"steps": len(self.steps)}

    def thaw(self, state: State) -> None:
        self.steps = [Step(0, 0, 0, ())] * state["steps"]


def says(topic: str, *messages: Message) -> Result:
    return Result(tuple(Output(topic, message) for message in messages))


def received(topic: str, node: str, sequence: int, stamp_ns: int = 0) -> Received:
    return Received(topic, node, "b", sequence, stamp_ns, Odometry(v=float(sequence), w=0.0))


IDLE = Command(mode="idle")
