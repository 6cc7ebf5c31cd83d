"""Asks why a recorded run failed, from the condition as a text to what was found."""

from collections.abc import Callable, Container
from typing import NamedTuple

from dynpf_formats.recording.reader import Recording
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.replay import scenario_of_replay

from dynpf_experiments.why.causes import events_of, ways_of
from dynpf_experiments.why.condition import parse
from dynpf_experiments.why.futures import Failure, Trunk, many
from dynpf_experiments.why.quantities import quantities_of
from dynpf_experiments.why.search import Reasons, Search, Task

__all__ = ["Answer", "Effort", "ask_why"]


class Effort(NamedTuple):
    """How many futures, of how many ticks after the failure, by how many processes, and the seed of their seeds."""

    futures: int = 200
    within: int = 100
    jobs: int = 1
    seed: int = 1


class Answer(NamedTuple):
    """What was found of a failed run, and the times of its ticks."""

    failure: Failure
    reasons: Reasons
    seconds: Callable[[int], float]


def ask_why(
    recording: Recording,
    when: str,
    effort: Effort,
    *,
    allow_code: Container[str] = (),
    show: Callable[[int], None] = lambda _: None,
) -> Answer:
    """Search for the moment from which a run could not but fail, and for the cause.

    ``show`` is called with the number of futures so far. Raises UsageError for a condition that cannot be read or never
    holds, and for a realtime run; RunError if the nodes do not do again what they did.
    """
    condition = parse(when)
    scenario = scenario_of_replay(recording, allow_code=allow_code)
    plan = plan_of(scenario)
    trunk = Trunk(recording, scenario, condition, quantities_of(condition, when, plan), effort.within)
    task = Task(trunk.failure.tick, plan.graph.nodes, events_of(scenario), ways_of(plan))
    with many(trunk, effort.jobs) as ask:
        reasons = Search(task, ask, budget=effort.futures, seed=effort.seed, show=show).run()
    return Answer(trunk.failure, reasons, trunk.seconds)
