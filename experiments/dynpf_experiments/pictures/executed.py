"""All particles of a run: a recording shows some, and the nodes that made them are executed again for the others."""

from collections.abc import Container, Sequence
from functools import partial

import numpy as np
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import PosesInFrame
from dynpf_runtime.node import Node, Showing
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.schema import Scenario

from dynpf.types import FloatArray
from dynpf_experiments.pictures.columns import evenly
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_experiments.pictures.tracks import Clouds

__all__ = ["executed_clouds", "with_executed"]

MOST_PARTICLES = 5000
"""Particles of a cloud that are drawn; a larger one is thinned by weight, as its node does."""


def executed_clouds(recording: Recording, scenario: Scenario, budget: Budget) -> list[Clouds]:
    """Return the clouds of the nodes that can show theirs whole, at moments of which the recording shows some.

    ``scenario`` is the recording's, ready to run. Raises what ``replay_node`` does.
    """
    source, plan = RunSource(recording, budget), plan_of(scenario)
    topics = [topic for topic in source.carrying(PosesInFrame) if topic.endswith("/particles")]
    found = []
    for topic in topics:
        name = topic.rpartition("/")[0]
        records = source.records(topic)
        chosen = evenly(len(records), budget.clouds // len(topics)).tolist()
        wanted = {records[index].stamp_ns for index in chosen}
        clouds: dict[int, FloatArray] = {}
        if name in plan.graph.specs:
            replay_node(recording, plan, name, observe=partial(_see, wanted, clouds))
        if clouds:
            seconds = np.array([(stamp - source.origin_ns) * 1e-9 for stamp in clouds])
            found.append(Clouds(name, seconds, list(clouds.values()), len(records)))
    return found


def _see(wanted: Container[int], clouds: dict[int, FloatArray], node: Node, entry: JournalEntry) -> None:
    """Note what a node shows after a step whose stamp is wanted."""
    if entry.stamp_ns in wanted and isinstance(node, Showing):
        shown = node.shown(MOST_PARTICLES)
        if shown is not None:
            clouds[entry.stamp_ns] = np.asarray(shown[:2], dtype=np.float64)


def with_executed(clouds: Sequence[Clouds], executed: Sequence[Clouds], most: int) -> list[Clouds]:
    """Return the clouds that are drawn, those that were executed in the place of the recorded; at most ``most``."""
    whole = {each.node: each for each in executed}
    found = []
    for recorded in clouds:
        each = whole.get(recorded.node, recorded)
        chosen = evenly(len(each.points), max(1, most // len(clouds)))
        found.append(each._replace(seconds=each.seconds[chosen], points=[each.points[index] for index in chosen]))
    return found
