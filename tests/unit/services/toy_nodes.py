"""Toy nodes for the tests of what surrounds a node."""

from collections.abc import Callable, Iterable

from dynpf_formats.shipped import known_topics
from dynpf_protocol.messages import Command, Message, Odometry
from dynpf_runtime.executor import Executor
from dynpf_runtime.graph import Graph, NodeSpec
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


def spec_of(node: ToyNode) -> NodeSpec:
    """Return what a graph holds of a toy node, which has its topics under their usual names."""
    return NodeSpec(
        name=node.name,
        kind=f"toy {node.name}",
        build=lambda: node,
        reads={topic: topic for topic in node.reads},
        writes={topic: known_topics()[topic] for topic in node.writes},
    )


def graph_of(nodes: Iterable[ToyNode]) -> Graph:
    """Return the graph of toy nodes that take their turns in the order given."""
    return Graph([spec_of(node) for node in nodes])


def executor_of(node: ToyNode, boot: str, digest_every: int) -> Executor:
    """Return an executor of a toy node in a run that has every topic of the table."""
    return Executor(node, spec_of(node), known_topics(), boot, digest_every)


def says(topic: str, *messages: Message) -> Result:
    return Result(tuple(Output(topic, message) for message in messages))


def received(topic: str, node: str, sequence: int, stamp_ns: int = 0) -> Received:
    return Received(topic, node, "b", sequence, stamp_ns, Odometry(v=float(sequence), w=0.0))


IDLE = Command()
