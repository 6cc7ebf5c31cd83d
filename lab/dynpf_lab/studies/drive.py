"""Runs for studies: a scenario as ``dynpf run`` runs it, in this process, observed instead of recorded.

``recorded_in`` turns the sink on: every run then goes into a recording, too.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from dynpf_protocol.topics import TOPICS
from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Node, Output, Received, Result, State, Step
from dynpf_services.scenario.build import build_node, plan_of
from dynpf_services.scenario.record import Log, record_inline
from dynpf_services.scenario.schema import Scenario

from dynpf_lab.measures.messages import Observed, RunMessages

__all__ = ["drive", "recorded_in", "remember"]

_FOLDER: ContextVar[Path | None] = ContextVar("folder of recordings", default=None)


@contextmanager
def recorded_in(folder: Path) -> Iterator[None]:
    """Record each run of a scenario's own nodes, while this holds, as ``folder``/0.mcap, 1.mcap and so on."""
    token = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(token)


def drive(
    scenario: Scenario,
    topics: Collection[str],
    log: Log | None = None,
    *,
    others: Mapping[str, Node] | None = None,
    remembered: Mapping[str, Node] | None = None,
    stopped: Callable[[Received], bool] | None = None,
) -> RunMessages:
    """Run ``scenario`` to its end and return its messages of some topics.

    ``log`` is what the sensors play, if they play one. ``others`` are nodes that take the place of the scenario's of
    the same names: such a run is never recorded. ``remembered`` are those of ``remember``, which give what the
    scenario's would; a run that is recorded has the scenario's. The tick after one with a
    message of these topics for which ``stopped`` says so is the last. Raises what the nodes raise.
    """
    observed = Observed(topics)
    ending = False

    def observe(received: Received) -> None:
        nonlocal ending
        observed(received)
        if stopped is not None and received.topic in topics and stopped(received):
            ending = True

    folder = _FOLDER.get()
    if folder is not None and not others:
        path = folder / f"{len(list(folder.glob('*.mcap')))}.mcap"
        record_inline(scenario, path, log, observe=observe, stopped=lambda: "enough was seen" if ending else "")
        return observed.run_of(scenario)
    plan = plan_of(scenario)
    given = {**(remembered or {}), **(others or {})}
    if given:
        plan = plan._replace(build=lambda: {name: given.get(name) or build_node(scenario, name) for name in plan.names})
    run_inline(plan, log.records if log else (), observe=observe, stopped=lambda: ending)
    return observed.run_of(scenario)


def remember(scenario: Scenario, names: Sequence[str], topics: Collection[str]) -> tuple[RunMessages, dict[str, Node]]:
    """Run the nodes ``names``, which read nothing of the scenario's others.

    Returns their messages of some topics, and nodes that give the same again, for the price of a look-up: however many
    estimators follow a robot on its way, the robot has to go it once. Raises ValueError for a node that reads what
    another writes.
    """
    nodes = {name: build_node(scenario, name) for name in names}
    others = set(scenario.nodes) - set(names)
    for name, node in nodes.items():
        if foreign := sorted(topic for topic in node.reads if others.intersection(TOPICS[topic].publishers)):
            raise ValueError(f"{name} reads {', '.join(foreign)}; expected nodes that read nothing of the others")
    memory: dict[str, _Remembered] = {name: _Remembered(node) for name, node in nodes.items()}
    observed = Observed(topics)

    def observe(received: Received) -> None:
        observed(received)
        memory[received.node].keep(received)

    run_inline(plan_of(scenario)._replace(names=tuple(names), build=lambda: nodes), (), observe=observe)
    return observed.run_of(scenario), dict(memory)


class _Remembered:
    """Gives what a node gave in a run that was; it has no state of its own."""

    def __init__(self, node: Node) -> None:
        self.name, self.reads, self.writes = node.name, node.reads, node.writes
        self._outputs: defaultdict[int, list[Output]] = defaultdict(list)

    def keep(self, received: Received) -> None:
        self._outputs[received.stamp_ns].append(Output(received.topic, received.message))

    def step(self, step: Step) -> Result:
        """Give what the node gave at this time."""
        return Result(tuple(self._outputs.get(step.stamp_ns, ())))

    def freeze(self) -> State:
        """Return nothing."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""
