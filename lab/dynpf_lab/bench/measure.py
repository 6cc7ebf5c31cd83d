"""Measures works in turns: ours, plain NumPy's, the peers', and again, so that disturbances affect all alike.

A row is a work with a number of particles; times are medians over the rounds, ratios are of medians.
"""

import gc
import time
import tracemalloc
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dynpf.maps.occupancy import OccupancyGrid
from dynpf_lab.bench.peers import PEERS, Peer
from dynpf_lab.bench.works import BEAMS, Landmarks, Step, Tracked, Work, build

__all__ = ["Plan", "Timing", "exponent", "interleaved", "measure"]

Row = dict[str, Any]
Timer = Callable[[int], float]
"""Returns the seconds for a number of updates."""

BUDGET_S = 1.0  # all rounds of a row together
TURN_S = 0.02  # a contender's turn, or an update if that takes longer
ROUNDS = (3, 25)
TOO_SLOW_S = 2.0  # comparisons with longer updates are left out
STAGES = ("motion", "likelihood", "normalization", "estimate", "resampling")


class Plan(NamedTuple):
    """The works, the numbers of particles, the beams and the threads to measure."""

    works: Sequence[str]
    counts: Sequence[int]
    beams: int | None
    threads: int


class Timing(NamedTuple):
    """Median over the rounds, and the interquartile range as a percentage of it."""

    ms: float
    spread_percent: float


def measure(plan: Plan, grid: OccupancyGrid, peers: Sequence[Peer], show: Callable[[str], None]) -> Iterable[Row]:
    """Yield the rows of the works at their numbers of particles, smallest first."""
    for name in plan.works:
        show(f"{name}: preparing")
        contest = _Contest(name, build(name, grid, plan.beams), plan, peers)
        for n in sorted(plan.counts):
            show(f"{name}, {n} particles")
            yield from contest.rows(n)


class _Contest:
    """A work by all contenders. ``seen`` has the time of an update of each at its last number of particles."""

    def __init__(self, name: str, work: Work, plan: Plan, peers: Sequence[Peer]) -> None:
        self.name = name
        self.work = work
        self.beams = (plan.beams or BEAMS[name]) if name in BEAMS else None
        self.threads = [1, plan.threads] if plan.threads > 1 and work.threaded else [1]
        self.peers = peers
        self.seen: dict[str, tuple[int, float]] = {}

    def rows(self, n: int) -> list[Row]:
        """Return the rows of the work with ``n`` particles, one for each number of threads."""
        gc.collect()
        timings = interleaved(self._timers(n))
        for peer in self.peers:
            peer.release()
        self.seen.update((contender, (n, timing.ms)) for contender, timing in timings.items())
        ours = timings["ours 1"]
        extra = {**_memory(self.work, n, ours), **_stages(self.work, n, ours)}
        factors = {"work": self.name, "n": n, "beams": self.beams}
        return [_row({**factors, "threads": threads}, timings, extra) for threads in self.threads]

    def _timers(self, n: int) -> dict[str, Timer]:
        timers = {f"ours {threads}": timer(self.work.ours(n, threads)) for threads in self.threads}
        if not self._too_slow("numpy", n):
            timers["numpy"] = timer(self.work.numpy(n))
        if isinstance(self.work, Landmarks):
            for peer in self.peers:
                if not self._too_slow(peer.name, n):
                    peer.prepare(self.work.problem, n)
                    timers[peer.name] = peer.seconds
        return timers

    def _too_slow(self, contender: str, n: int) -> bool:
        if contender not in self.seen:
            return False
        before, ms = self.seen[contender]
        return 1e-3 * ms * n / before > TOO_SLOW_S


def _row(factors: Row, timings: Mapping[str, Timing], extra: Row) -> Row:
    ours = timings[f"ours {factors['threads']}"]
    row = {**factors, "ours_ms": ours.ms, "ours_spread_percent": ours.spread_percent}
    for contender in ("numpy", *PEERS):
        timing = timings.get(contender)
        row[f"{contender}_ms"] = None if timing is None else timing.ms
        row[f"{contender}_spread_percent"] = None if timing is None else timing.spread_percent
        row[f"ratio_{contender}"] = None if timing is None else timing.ms / ours.ms
    return {**row, **extra}


def timer(step: Step) -> Timer:
    """Return a function that measures a number of updates."""

    def seconds(updates: int) -> float:
        """Return the seconds that the updates took."""
        began = time.perf_counter()
        for _ in range(updates):
            step()
        return time.perf_counter() - began

    return seconds


def interleaved(timers: Mapping[str, Timer], budget_s: float = BUDGET_S) -> dict[str, Timing]:
    """Return the time of an update of each contender, measured in turns after two warm-up updates."""
    once = {name: _warm(seconds) for name, seconds in timers.items()}
    turns = {name: max(1, round(TURN_S / max(took, 1e-7))) for name, took in once.items()}
    a_round = sum(turns[name] * took for name, took in once.items())
    rounds = int(np.clip(budget_s / a_round, *ROUNDS))
    samples: dict[str, list[float]] = {name: [] for name in timers}
    for _ in range(rounds):
        for name, seconds in timers.items():
            samples[name].append(1e3 * seconds(turns[name]) / turns[name])
    return {name: _timing(values) for name, values in samples.items()}


def _warm(seconds: Timer) -> float:
    """Return the time of the second update, since the first may compile, load and allocate."""
    seconds(1)
    return seconds(1)


def _timing(values: Sequence[float]) -> Timing:
    low, middle, high = (float(value) for value in np.quantile(values, (0.25, 0.5, 0.75)))
    return Timing(middle, 100.0 * (high - low) / middle)


def _stages(work: Work, n: int, whole: Timing) -> Row:
    """Return the time of each part of our update, None where it has no parts or takes long."""
    steps = work.stages(n) if whole.ms < 200.0 else {}
    timings = interleaved({name: timer(step) for name, step in steps.items()}, 0.3 * BUDGET_S) if steps else {}
    return {f"{stage}_ms": timings[stage].ms if stage in timings else None for stage in STAGES}


def _memory(work: Work, n: int, whole: Timing) -> Row:
    """Return the number of particles after an update, and the bytes per particle: kept between updates, and at peak.

    The first are the arrays of a cloud; the second are NumPy's allocations in an update, as traced by tracemalloc, in
    addition to the cloud at its beginning. Allocations of kernels, in blocks of 256 particles, are not traced.
    """
    kept = peak = None
    used = n
    if whole.ms < 500.0:
        step = work.ours(n, 1)
        for _ in range(5):  # until the number of particles has adapted
            step()
        tracemalloc.start()
        done = step()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        if isinstance(done, Tracked):
            used = done.cloud.weights.size
            kept = sum(array.nbytes for array in done.cloud[:3]) / used
        peak = most / used
    return {"n_used": used, "bytes_per_particle": kept, "peak_bytes_per_particle": peak}


def exponent(counts: Sequence[int], ms: Sequence[float]) -> float | None:
    """Return the k of cost ~ N^k by least squares on logarithms; None of fewer than two numbers of particles."""
    if len(set(counts)) < 2:
        return None
    return float(np.polyfit(np.log(counts), np.log(ms), 1)[0])
