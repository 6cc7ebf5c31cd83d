"""PARTS's Table 4.3: times of a step of the robot's filter, of the estimator and of the controller."""

import math
import time
from collections.abc import Iterator

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_runtime.node import Node, Result, State, Step
from dynpf_services.scenario.build import build_node

from dynpf.rng import Stream
from dynpf.types import Count
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.messages import PartsCommand, PartsEstimate
from dynpf_systems.parts.robot_filters import Seen, fused, robot_filter
from dynpf_systems.parts.studies.figures import draw_times
from dynpf_systems.parts.studies.runs import PROCESS, Conditions, layout_task, parts_scenario, run_parts
from dynpf_systems.parts.studies.trials import FACTOR_COLUMNS, Goals, Parts, run_seed, samples_of
from dynpf_systems.parts.task import NOISE, NoisyLevel, RearrangementTask

__all__ = ["STUDY", "TimeSettings"]

PRINTED_MS = {
    ("mate", 49): 40,
    ("mate", 100): 72,
    ("mate", 225): 150,
    ("move", 49): 90,
    ("move", 100): 173,
    ("move", 225): 380,
}
"""PARTS, Table 4.3: time of a step of the particle filter in ms."""


class TimeSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The layout, the noise level, and the numbers of particles."""

    parts: Parts = 6
    goals: Goals = "H"
    noise: NoisyLevel = "medium"
    n: tuple[Count, ...] = (49, 100, 225)


def _time_parts(settings: TimeSettings, trials: int, seed: int) -> list[tuple[TimeSettings, int, int]]:
    """Return a single task, since parallel tasks would disturb each other's times."""
    return [(settings, trials, seed)]


def _run_times(task: tuple[TimeSettings, int, int]) -> list[Sample]:
    """Return a sample for each step of estimator and controller, and for each step of the filter alone."""
    settings, trials, seed = task
    layout = layout_task(f"{settings.parts}{settings.goals}")
    variance = NOISE[settings.noise].measurement
    samples = []
    for n in settings.n:
        run_parts(layout, seed, Conditions(variance, n, max_ticks=40))  # warm-up
        common = {"parts": settings.parts, "goals": settings.goals, "noise": settings.noise, "n": n}
        for stage in ("mate", "move"):
            factors = {**common, "filter": "optimal", "stage": stage}
            samples += [
                Sample(factors, {"filter_ms": spent, "estimator_ms": math.nan, "controller_ms": math.nan})
                for spent in _filter_times(n, variance, held=stage == "move")
            ]
        for trial in range(trials):
            for stage, estimator, controller in _step_times(layout, run_seed(seed, settings.goals, trial), variance, n):
                times = {"filter_ms": math.nan, "estimator_ms": 1e3 * estimator, "controller_ms": 1e3 * controller}
                samples += [Sample({**common, "filter": "optimal", "stage": where}, times) for where in (stage, "all")]
    return samples


class _Clocked:
    """A node whose steps are timed, in seconds, with their results."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.name = node.name
        self.step_times: list[tuple[float, Result]] = []

    def step(self, step: Step) -> Result:
        """Execute the node's step."""
        begun = time.perf_counter()
        result = self._node.step(step)
        self.step_times.append((time.perf_counter() - begun, result))
        return result

    def freeze(self) -> State:
        """Return the node's state."""
        return self._node.freeze()

    def thaw(self, state: State) -> None:
        """Restore the node's state."""
        self._node.thaw(state)


def _step_times(layout: RearrangementTask, seed: int, variance: float, n: int) -> Iterator[tuple[str, float, float]]:
    """Yield stage and seconds of each step of estimator and controller in which the robot is not idle."""
    conditions = Conditions(variance, n)
    scenario = parts_scenario(layout, seed, conditions)
    estimator, controller = (_Clocked(build_node(scenario, name)) for name in ("estimator", "controller"))
    run_parts(layout, seed, conditions, {"estimator": estimator, "controller": controller})
    for (filtering, estimated), (deciding, decided) in zip(estimator.step_times, controller.step_times, strict=True):
        estimate = next(
            (output.message for output in estimated.outputs if isinstance(output.message, PartsEstimate)), None
        )
        command = next(output.message for output in decided.outputs if isinstance(output.message, PartsCommand))
        if estimate is not None and (command.mode != "idle" or estimate.held >= 0):
            yield "move" if estimate.held >= 0 else "mate", filtering, deciding


def _filter_times(n: int, variance: float, *, held: bool, steps: int = 400) -> list[float]:
    """Return the times in ms of steps of the robot's filter alone, with one disc in view or, if ``held``, two."""
    particles = robot_filter(RearrangementConfig(n=n, measurement_variance=variance))
    sight = Seen(np.zeros(2), variance)
    belief = particles.start(sight, Stream.of(0, "time", 0))
    times = []
    for step in range(steps):
        stream = Stream.of(0, "time", step, "robot")
        begun = time.perf_counter()
        seen = fused([sight, sight] if held else [sight])
        belief = particles.step(belief, np.zeros(2), PROCESS, seen, stream)
        times.append(1e3 * (time.perf_counter() - begun))
    return times


def _time_rows(samples: list[Sample]) -> list[Row]:
    rows = [row for row in summarized(samples, "goals") if row["goals"] != "all"]
    for row in rows:
        row["printed_filter_ms"] = PRINTED_MS.get((row["stage"], row["n"]))
        for name in ("filter_ms", "estimator_ms", "controller_ms"):
            values = [measures[name] for measures in samples_of(row, samples)]
            if not np.isnan(values).all():
                row[f"{name}_best"] = float(np.nanmin(values))
                row[f"{name}_p99"] = float(np.nanquantile(values, 0.99))
    return rows


_TIMES = "{0}_ms_best {0}_ms_median {0}_ms_p99"

STUDY = Study(
    about="PARTS's Table 4.3: times of a step of the filter and of the controller",
    trials=3,
    settings=TimeSettings,
    tasks=_time_parts,
    run_task=_run_times,
    rows=_time_rows,
    columns=(
        *FACTOR_COLUMNS,
        ("stage", "", "stage"),
        ("steps", "", "trials"),
        ("filter ms: best / median / 99 %", ".3f", _TIMES.format("filter")),
        ("printed", ".0f", "printed_filter_ms"),
        ("estimator", ".3f", _TIMES.format("estimator")),
        ("controller", ".3f", _TIMES.format("controller")),
    ),
    figures=lambda _settings, _seed, rows, folder: draw_times(rows, folder),
)
