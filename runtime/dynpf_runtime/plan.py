"""The plan of a run: all that the runtime knows of it. Whoever reads scenarios makes one; the runtime reads none."""

from typing import Literal, NamedTuple

from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect

from dynpf_runtime.faults import Fault
from dynpf_runtime.graph import Graph

__all__ = ["Plan", "run_header"]


class Plan(NamedTuple):
    """Nodes, clock and limits of a run.

    ``text`` is the resolved scenario, by which processes that meet tell that they mean the same run; the runtime
    compares it only.
    """

    graph: Graph
    seed: int
    clock: Literal["lockstep", "realtime"]
    rate: float | None  # times as fast as its own time; None: as fast as it can, in real time once
    tick_ns: int
    max_ticks: int
    plays_log: bool  # the source plays a log instead of making ticks of its own
    state_digest_ticks: int  # a digest of each node's state every so many steps
    faults: tuple[Fault, ...]
    text: str


def run_header(plan: Plan) -> RunHeader:
    """Return the header of a run of ``plan`` made by this program here."""
    return RunHeader(
        scenario=plan.text,
        seed=plan.seed,
        provenance=collect(),
        writes={name: tuple(row.name for row in spec.writes.values()) for name, spec in plan.graph.specs.items()},
    )
