"""Runs for studies: a scenario as ``dynpf run`` runs it, in this process, observed instead of recorded.

``recorded_in`` also writes every run into a recording.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from dynpf_runtime.executor import Executor
from dynpf_runtime.graph import Graph, NodeSpec
from dynpf_runtime.inline import BOOT, run_inline
from dynpf_runtime.node import Node, Received, Result, State, Step
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.record import Log, record_inline
from dynpf_services.scenario.schema import Scenario

from dynpf_experiments.messages import Observed, RunMessages

__all__ = ["drive", "follow_inputs", "inputs_of", "recorded_in"]

_FOLDER: ContextVar[Path | None] = ContextVar("folder of recordings", default=None)


@contextmanager
def recorded_in(folder: Path) -> Iterator[None]:
    """Within this context, record each run of a scenario's own nodes as ``folder``/0.mcap, 1.mcap and so on."""
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
    stopped: Callable[[Received], bool] | None = None,
) -> RunMessages:
    """Run ``scenario`` to its end and return its messages of some topics.

    ``log`` is the log that the sensors play, if any. ``others`` are nodes that replace the scenario's nodes of the same
    names; such a run is never recorded. The run ends one tick after a message of these topics for which ``stopped``
    returns true. Raises what the nodes raise.
    """
    observed = Observed(topics)
    ending = False

    def observe(received: Received) -> None:
        """Keep the message, and end the run where it is asked for."""
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
    if others:
        specs = plan.graph.specs.values()
        plan = plan._replace(graph=Graph([_with(spec, others.get(spec.name)) for spec in specs]))
    run_inline(plan, log.records if log else (), observe=observe, stopped=lambda: ending)
    return observed.run_of(scenario)


def _with(spec: NodeSpec, other: Node | None) -> NodeSpec:
    """Return the spec with ``other`` as its node; the attribute ``reads`` of ``other`` may name other topics."""
    if other is None:
        return spec
    reads = getattr(other, "reads", None)
    return spec._replace(build=lambda: other, reads=spec.reads if reads is None else {topic: topic for topic in reads})


def inputs_of(scenario: Scenario, reader: str, topics: Collection[str]) -> tuple[RunMessages, list[Step]]:
    """Run ``scenario`` without the node ``reader``, whose output no other node may read.

    Returns the messages of some topics, and the steps that the node would be given, so that several filters can follow
    the same run. Raises ValueError where some node reads a topic that the reader writes.
    """
    plan = plan_of(scenario)
    written = {row.name for row in plan.graph.specs[reader].writes.values()} - {"log"}
    for name, spec in plan.graph.specs.items():
        if name != reader and (read := sorted(written & spec.reads.keys())):
            raise ValueError(
                f"{name} reads {', '.join(read)} of {reader}; expected a run that does not depend on {reader}"
            )
    if scenario.faults:
        raise ValueError("the scenario has faults, whose gaps only the host of a node reports")
    probe, observed = _Probe(reader), Observed(topics)
    specs = [spec if name != reader else probe.spec(spec, plan.graph) for name, spec in plan.graph.specs.items()]
    run_inline(plan._replace(graph=Graph(specs)), (), observe=observed)
    return observed.run_of(scenario), probe.steps


def follow_inputs(scenario: Scenario, reader: str, steps: Sequence[Step], topics: Collection[str]) -> RunMessages:
    """Return the messages of the node ``reader`` in a run of ``scenario`` in which it is given ``steps``.

    They equal those of ``drive``, without executing the other nodes; a recorded run executes all nodes.
    """
    if _FOLDER.get() is not None:
        return drive(scenario, topics)
    observed = Observed(topics)
    graph = plan_of(scenario).graph
    spec = graph.specs[reader]
    executor = Executor(spec.build(), spec, graph.topics, BOOT, scenario.state_digest_ticks)
    for step in steps:
        inputs = [received for received in step.inputs if received.topic in spec.reads]
        sent, _ = executor.step_unsent(step.tick, step.stamp_ns, inputs)
        for unsent in sent:
            envelope = unsent.envelope
            observed(Received(unsent.topic, reader, BOOT, envelope.sequence, envelope.stamp_ns, unsent.content))
    return observed.run_of(scenario)


class _Probe:
    """A node that keeps its steps, with the messages of all other nodes as inputs."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.steps: list[Step] = []

    def spec(self, replaced: NodeSpec, graph: Graph) -> NodeSpec:
        """Return the spec with the probe instead of its node."""
        others = [spec for name, spec in graph.specs.items() if name != self.name]
        reads = {row.name: row.name for spec in others for row in spec.writes.values()}
        return replaced._replace(build=lambda: self, reads=reads, writes={})

    def step(self, step: Step) -> Result:
        """Keep the step."""
        self.steps.append(step)
        return Result()

    def freeze(self) -> State:
        """Return no state: the kept steps are no state of a node."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""
