"""A robot that is not where it was thought to be: it slipped, or was set down elsewhere. Neither is believed lightly.

A scan that the particles do not explain may be of a robot whose wheels have slipped, of one that was carried off, of
things that are not on the map, or of a place that is not. The first is looked for around the particles, the second
anywhere on the map. Unmapped things are the most frequent of all, and they make other places look better: so a place is
taken only when it has explained several scans on the way, much better than the track, and no other one does as well.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from dynpf.filters.adaptation import Doubt, uninformative
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import pose_estimate
from dynpf.filters.models import Models
from dynpf.filters.search import Places, Search
from dynpf.params import validated
from dynpf.portable import hypot
from dynpf.se2 import wrap_angle
from dynpf.types import Count, FloatArray, Floats, OpenShare, Positive, Share

__all__ = ["Hypothesis", "Relocation", "RelocationMemory", "RelocationParams"]

APART_M, APART_RAD = 1.0, 0.5
"""Places that are closer to each other in both are the same."""

_MOST_DOUBLINGS = 60
"""Of the wait between searches: so many updates never pass."""


class RelocationParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="relocation"
):
    """When the particles are doubted, and what it takes to believe in another place."""

    drop: Positive = 6.0  # nats that an update's log-evidence falls below the usual, then it is doubted
    # Of a reading, natural logarithm: below it nothing is explained, however usual that is, and such readings are not
    # taken in. It depends on the measurement model, so there is none by default.
    log_likelihood_lost: float | None = None
    alpha: OpenShare = 0.05  # of the way from the usual log-evidence to the newest, at each update
    n_eff_least: Share = (
        0.005  # effective particles as a share of all: below it those that explain a scan are stragglers
    )
    slip_m: Positive = 0.6  # around the particles, where a robot is looked for that has slipped
    slip_rad: Positive = 0.6
    scans: Count = 5  # that a place has to explain, one after the other
    proof: Positive = 12.0  # nats by which it explains them better than the track does, in the mean
    # Share of a scan by which the map contradicts the track more than the place: things not on it contradict little.
    refuted: Share = 0.35
    margin: Positive = 6.0  # nats by which it is ahead of every other place, altogether
    hypotheses: Count = 8  # places that are followed at once, at most
    patience: Count = 16  # most updates between searches that find nothing


class Hypothesis(NamedTuple):
    """A place where the robot may be instead: its pose now (m, rad), and how it explains the scans since then."""

    x: float
    y: float
    theta: float
    gain: float = 0.0  # nats, over what the track explains, summed
    against: float = 0.0  # share of a scan that the map contradicts from the track, less that from here, summed
    scans: float = 0.0


class _Puzzle(NamedTuple):
    """Readings that neither the track nor a slip explains."""

    readings: Sequence[Any]
    least: float  # log-evidence from which on they would be explained
    mean: FloatArray  # pose (3,) of the track
    track: float  # their log-likelihood at the best pose about it
    against: float  # their share that the map contradicts from there


class RelocationMemory(NamedTuple):
    """What a Relocation remembers between updates."""

    usual: float  # log-evidence of a reading
    updates: float  # that it is the mean of
    unexplained: float = 0.0  # updates in a row that neither the track nor a slip explains
    unheard: float = 0.0  # of them, the last ones in a row whose readings were not taken in
    unfit: float = 0.0  # searches in a row that found no place which explains the readings as usual
    wait: float = 0.0  # updates until the next search
    hypotheses: tuple[Hypothesis, ...] = ()

    @property
    def numbers(self) -> tuple[float, ...]:
        """All of it as plain numbers; see ``recalled``."""
        return (*self[:6], *(number for place in self.hypotheses for number in place))


_HYPOTHESES = slice(6, None)


def recalled(numbers: tuple[float, ...]) -> RelocationMemory:
    """Return the memory of plain numbers."""
    rest = numbers[_HYPOTHESES]
    size = len(Hypothesis._fields)
    places = tuple(Hypothesis(*rest[start : start + size]) for start in range(0, len(rest), size))
    usual, updates, unexplained, unheard, unfit, wait = numbers[: _HYPOTHESES.start]
    return RelocationMemory(usual, updates, unexplained, unheard, unfit, wait, places)


class Relocation:
    """Tests of the track against a slip, and against hypotheses of other places that are followed by odometry.

    Multiple hypotheses are tracked as Jensfelt and Kristensen (2001) and Austin and Jensfelt (2000) do, but outside of
    the belief: the particles stay the track's until one of the others has proven itself. A robot that is off its map
    goes on by odometry, for no place explains what it sees.
    """

    def __init__(self, params: RelocationParams, search: Search) -> None:
        self.params = validated(params)
        self.search = search

    def begin(self) -> tuple[float, ...]:
        """Return the memory of having seen nothing."""
        return ()

    def surprised(self, cloud: Cloud, models: Models, readings: Sequence[Any]) -> bool:
        """Return whether readings that need not be taken in yet are explained worse than usual."""
        if not cloud.memory:
            return False
        evidence, _ = models.believable(cloud.particles, cloud.weights, readings)
        if not evidence:
            return False
        likelihood = models.log_likelihood(cloud.particles, evidence).astype(np.float64)
        count = sum(int(each.readings) for each in evidence)
        mean = float(np.sum(cloud.weights * likelihood, dtype=np.float64))
        return mean < self._least(recalled(cloud.memory), count)

    def carried(self, memory: tuple[float, ...], models: Models, control: Any) -> tuple[float, ...]:
        """Return the memory after a movement: hypotheses go where odometry takes them."""
        if len(memory) <= _HYPOTHESES.start:
            return memory
        known = recalled(memory)
        if not hasattr(models.motion, "expected"):  # nothing tells where they go
            return known._replace(hypotheses=()).numbers
        poses = np.array([place[:3] for place in known.hypotheses]).T
        moved = models.motion.expected(poses, control)
        places = (
            place._replace(x=x, y=y, theta=theta)
            for place, (x, y, theta) in zip(known.hypotheses, moved[:3].T.tolist(), strict=True)
        )
        return known._replace(hypotheses=tuple(places)).numbers

    def doubt(self, cloud: Cloud, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        """See Rescuer; the memory is a RelocationMemory's numbers, or empty."""
        if uninformative(log_evidence, count):
            return Doubt(cloud.memory, 0.0, self.search)
        if not cloud.memory:
            return self._first(log_evidence, count, readings)
        known = recalled(cloud.memory)
        least = self._least(known, count)
        averaged = self._averaged(known, max(log_evidence, least) / count)
        estimate = pose_estimate(cloud.particles, cloud.weights)
        together = float(np.max(np.diagonal(estimate.covariance)[:2])) <= self.params.slip_m * self.params.slip_m
        # A robot that was off the map has particles all over it, some of which explain any scan.
        scattered = known.unheard > 0.0 and not together
        spread = cloud.n_eff >= self.params.n_eff_least * cloud.weights.size
        if log_evidence >= least and spread and not scattered:
            return Doubt(averaged.numbers, 0.0, self.search)
        near = self.search.near(estimate.mean, readings, self.params.slip_m, self.params.slip_rad)
        if near.log_likelihood >= least and not scattered:
            return Doubt(averaged.numbers, 1.0, near, near, settled=True)
        heard = together and near.log_likelihood >= self._lost(count)
        doubted = (averaged if heard else known)._replace(
            unexplained=known.unexplained + 1.0,
            unheard=0.0 if heard else known.unheard + 1.0,
            unfit=known.unfit,
            wait=known.wait,
            hypotheses=known.hypotheses,
        )
        against = 1.0 if scattered else self.search.contradicted(near.best, readings)
        track = self._lost(count) if scattered else near.log_likelihood
        return self._tested(doubted, _Puzzle(readings, least, estimate.mean, track, against))

    def _tested(self, memory: RelocationMemory, puzzle: _Puzzle) -> Doubt:
        """Return the doubt after the hypotheses, and if there are none left what a search finds, were tested."""
        memory, places = self._followed(memory, puzzle)
        if not memory.hypotheses:
            memory = self._searched(memory, puzzle)
        winner = self._proven(memory.hypotheses)
        if winner is not None:
            found = places[winner]
            accepted = RelocationMemory(memory.usual, memory.updates)
            return Doubt(accepted.numbers, 1.0, found, found, jumped=1.0, settled=True)
        return Doubt(
            memory.numbers,
            0.0,
            self.search,
            unfit=int(memory.unfit),
            unexplained=int(memory.unexplained),
            unheard=int(memory.unheard),
        )

    def _followed(self, memory: RelocationMemory, puzzle: _Puzzle) -> tuple[RelocationMemory, list[Places]]:
        """Return the memory with those hypotheses that explain the readings, too, and where each is exactly."""
        kept: list[Hypothesis] = []
        where: list[Places] = []
        reach = 0.5 * self.params.slip_m, 0.5 * self.params.slip_rad
        for place in memory.hypotheses:
            around = self.search.near(np.array(place[:3]), puzzle.readings, *reach)
            if around.log_likelihood < puzzle.least:
                continue
            found = self._judged(around.best, around.log_likelihood, puzzle, place)
            if not any(_same(found, other) for other in kept):
                kept.append(found)
                where.append(around)
        return memory._replace(hypotheses=tuple(kept)), where

    def _searched(self, memory: RelocationMemory, puzzle: _Puzzle) -> RelocationMemory:
        """Return the memory with the places that a search of the map finds, unless it waits."""
        if memory.wait > 0.0:
            return memory._replace(wait=memory.wait - 1.0)
        places = self.search.places(puzzle.readings)
        here = Hypothesis(*puzzle.mean.tolist())
        found = [
            self._judged(pose, log_likelihood, puzzle, here)
            for pose, log_likelihood in places.distinct(self.params.hypotheses, APART_M, APART_RAD)
            if log_likelihood >= puzzle.least
        ]
        found = [place for place in found if not _same(place, here)]
        unfit = 0.0 if found else memory.unfit + 1.0
        wait = min(math.ldexp(1.0, min(int(unfit), _MOST_DOUBLINGS)), float(self.params.patience)) - 1.0
        return memory._replace(hypotheses=tuple(found), unfit=unfit, wait=wait)

    def _judged(self, pose: Floats, log_likelihood: float, puzzle: _Puzzle, before: Hypothesis) -> Hypothesis:
        """Return a hypothesis at a pose after one scan more than ``before``."""
        x, y, theta = pose.tolist()
        gain = before.gain + log_likelihood - puzzle.track
        against = before.against + puzzle.against - self.search.contradicted(pose, puzzle.readings)
        return Hypothesis(x, y, theta, gain, against, before.scans + 1.0)

    def _proven(self, places: Sequence[Hypothesis]) -> int | None:
        """Return which hypothesis is to be believed, None for none."""
        if not places:
            return None
        order = sorted(range(len(places)), key=lambda index: -places[index].gain)
        best = places[order[0]]
        params = self.params
        if best.scans < params.scans:
            return None
        proven = best.gain >= params.proof * best.scans and best.against >= params.refuted * best.scans
        ahead = len(order) < 2 or best.gain - places[order[1]].gain >= params.margin
        return order[0] if proven and ahead else None

    def _first(self, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        places = self.search.places(readings)
        usual = max(log_evidence, places.log_likelihood - self.params.drop) / count
        return Doubt(RelocationMemory(usual, 1.0).numbers, 0.0, self.search)

    def _least(self, known: RelocationMemory, count: int) -> float:
        """Return the log-evidence from which on so many readings are explained."""
        return max(known.usual * count - self.params.drop, self._lost(count))

    def _lost(self, count: int) -> float:
        """Return the log-evidence below which so many readings are of nothing on the map."""
        least = self.params.log_likelihood_lost
        return -math.inf if least is None else least * count

    def _averaged(self, memory: RelocationMemory, newest: float) -> RelocationMemory:
        rate = max(self.params.alpha, 1.0 / (memory.updates + 1.0))
        return RelocationMemory(memory.usual + rate * (newest - memory.usual), memory.updates + 1.0)


def _same(place: Hypothesis, other: Hypothesis) -> bool:
    turn = abs(float(wrap_angle(place.theta - other.theta)))
    return hypot(place.x - other.x, place.y - other.y) <= APART_M and turn <= APART_RAD
