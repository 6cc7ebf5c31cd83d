"""The plan of a run: all that the runtime knows of it. The reader of scenarios makes it; the runtime reads none."""

from typing import Literal, NamedTuple

from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect

from dynpf_runtime.faults import Fault, LeftOut
from dynpf_runtime.graph import Graph

__all__ = ["Plan", "run_header", "written_topics"]


class Plan(NamedTuple):
    """Nodes, clock and limits of a run.

    ``text`` is the resolved scenario. Processes compare it to check that they belong to the same run; the runtime does
    not interpret it.
    """

    graph: Graph
    seed: int
    clock: Literal["lockstep", "realtime"]
    rate: float | None  # logical time over wall-clock time; None: as fast as possible in lockstep, 1 in realtime
    tick_ns: int
    max_ticks: int
    plays_log: bool  # the records of a log begin the ticks, instead of a clock
    state_digest_ticks: int  # steps between two digests of a node's state
    faults: tuple[Fault, ...]
    text: str
    snapshot_digests: int = 0  # of so many digests of a state one has a snapshot; 0: as a budget allows
    left_out: tuple[LeftOut, ...] = ()  # of a branch, and no part of the scenario


def written_topics(plan: Plan) -> dict[str, tuple[str, ...]]:
    """Return the topics that each node of a run writes, by its name."""
    return {name: tuple(row.name for row in spec.writes.values()) for name, spec in plan.graph.specs.items()}


def run_header(plan: Plan) -> RunHeader:
    """Return the recording header of a run of ``plan`` on this machine."""
    return RunHeader(
        scenario=plan.text,
        seed=plan.seed,
        provenance=collect(),
        writes=written_topics(plan),
        clock=plan.clock,
    )
