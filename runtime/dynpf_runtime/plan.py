"""The plan of a run: all that the runtime knows of it. Whoever reads scenarios makes one; the runtime reads none."""

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect

from dynpf_runtime.faults import Fault
from dynpf_runtime.node import Node

__all__ = ["Plan", "run_header"]


class Plan(NamedTuple):
    """Nodes, clock and limits of a run.

    ``build`` makes the nodes by name, each in its first state; it raises what is wrong with them. ``text`` is the
    resolved scenario, by which processes that meet tell that they mean the same run; the runtime compares it only.
    """

    names: tuple[str, ...]  # of the nodes, in tick order; the first is the source
    build: Callable[[], Mapping[str, Node]]
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
    return RunHeader(scenario=plan.text, seed=plan.seed, provenance=collect())
