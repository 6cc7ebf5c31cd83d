"""A robot that is not where it was thought to be: it slipped, or it was set down elsewhere. Neither is believed lightly.

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
from dynpf.types import Count, FloatArray, OpenShare, Positive

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
    slip_m: Positive = 0.6  # around the particles, where a robot is looked for that has slipped
    slip_rad: Positive = 0.6
    scans: Count = 3  # that a place has to explain, one after the other
    proof: Positive = 12.0  # nats by which it explains them better than the track does, in the mean
    margin: Positive = 6.0  # nats by which it is ahead of every other place, altogether
    hypotheses: Count = 8  # places that are followed at once, at most
    patience: Count = 16  # most updates between searches that find nothing


class Hypothesis(NamedTuple):
    """A place where the robot may be instead: its pose now (m, rad), and how it explains the scans since it was found."""

    x: float
    y: float
    theta: float
    gain: float  # nats, over what the track explains, summed
    scans: float


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
    return RelocationMemory(*numbers[:6], places)


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
        poses = np.array([place[:3] for place in known.hypotheses]).T
        moved = models.motion.expected(poses, control)  # type: ignore[attr-defined]
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
        if log_evidence >= least:
            return Doubt(averaged.numbers, 0.0, self.search)
        mean = pose_estimate(cloud.particles, cloud.weights).mean
        near = self.search.near(mean, readings, self.params.slip_m, self.params.slip_rad)
        if near.log_likelihood >= least:
            return Doubt(averaged.numbers, 1.0, near, near, settled=True)
        doubted = averaged._replace(
            unexplained=known.unexplained + 1.0,
            unheard=known.unheard,
            unfit=known.unfit,
            wait=known.wait,
            hypotheses=known.hypotheses,
        )
        return self._tested(doubted, mean, near, least, count, readings)

    def _tested(
        self, memory: RelocationMemory, mean: FloatArray, track: Places, least: float, count: int, readings: Sequence[Any]
    ) -> Doubt:
        """Return the doubt after the hypotheses, and if there are none left what a search finds, were tested."""
        memory, places = self._followed(memory, track.log_likelihood, least, readings)
        if not memory.hypotheses:
            memory = self._searched(memory, mean, track.log_likelihood, least, readings)
        lost = -math.inf if self.params.log_likelihood_lost is None else self.params.log_likelihood_lost * count
        memory = memory._replace(unheard=memory.unheard + 1.0 if track.log_likelihood < lost else 0.0)
        doubt = Doubt(
            memory.numbers,
            0.0,
            self.search,
            unfit=int(memory.unfit),
            unexplained=int(memory.unexplained),
            unheard=int(memory.unheard),
        )
        winner = self._proven(memory.hypotheses)
        if winner is None:
            return doubt
        memory = RelocationMemory(memory.usual, memory.updates)
        found = places[winner]
        return doubt._replace(
            memory=memory.numbers, share=1.0, source=found, places=found, jumped=1.0, unfit=0, unexplained=0, unheard=0, settled=True
        )

    def _followed(
        self, memory: RelocationMemory, track: float, least: float, readings: Sequence[Any]
    ) -> tuple[RelocationMemory, list[Places]]:
        """Return the memory with those hypotheses that explain the readings, too, and where each is exactly."""
        kept: list[Hypothesis] = []
        where: list[Places] = []
        for place in memory.hypotheses:
            around = self.search.near(np.array(place[:3]), readings, 0.5 * self.params.slip_m, 0.5 * self.params.slip_rad)
            if around.log_likelihood < least:
                continue
            x, y, theta = around.best.tolist()
            found = Hypothesis(x, y, theta, place.gain + around.log_likelihood - track, place.scans + 1.0)
            if not any(_same(found, other) for other in kept):
                kept.append(found)
                where.append(around)
        return memory._replace(hypotheses=tuple(kept)), where

    def _searched(
        self, memory: RelocationMemory, mean: FloatArray, track: float, least: float, readings: Sequence[Any]
    ) -> RelocationMemory:
        """Return the memory with the places that a search of the map finds, unless it waits."""
        if memory.wait > 0.0:
            return memory._replace(wait=memory.wait - 1.0)
        places = self.search.places(readings)
        here = Hypothesis(*mean.tolist(), 0.0, 0.0)
        found = [
            Hypothesis(*pose.tolist(), log_likelihood - track, 1.0)
            for pose, log_likelihood in places.distinct(self.params.hypotheses, APART_M, APART_RAD)
            if log_likelihood >= least
        ]
        found = [place for place in found if not _same(place, here)]
        unfit = 0.0 if found else memory.unfit + 1.0
        wait = min(math.ldexp(1.0, min(int(unfit), _MOST_DOUBLINGS)), float(self.params.patience)) - 1.0
        return memory._replace(hypotheses=tuple(found), unfit=unfit, wait=wait)

    def _proven(self, places: Sequence[Hypothesis]) -> int | None:
        """Return which hypothesis is to be believed, None for none."""
        if not places:
            return None
        order = sorted(range(len(places)), key=lambda index: -places[index].gain)
        best = places[order[0]]
        if best.scans < self.params.scans or best.gain < self.params.proof * best.scans:
            return None
        ahead = len(order) < 2 or best.gain - places[order[1]].gain >= self.params.margin
        return order[0] if ahead else None

    def _first(self, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        places = self.search.places(readings)
        usual = max(log_evidence, places.log_likelihood - self.params.drop) / count
        return Doubt(RelocationMemory(usual, 1.0).numbers, 0.0, self.search)

    def _least(self, known: RelocationMemory, count: int) -> float:
        """Return the log-evidence from which on so many readings are explained."""
        least = known.usual * count - self.params.drop
        if self.params.log_likelihood_lost is not None:
            least = max(least, self.params.log_likelihood_lost * count)
        return least

    def _averaged(self, memory: RelocationMemory, newest: float) -> RelocationMemory:
        rate = max(self.params.alpha, 1.0 / (memory.updates + 1.0))
        return RelocationMemory(memory.usual + rate * (newest - memory.usual), memory.updates + 1.0)


def _same(place: Hypothesis, other: Hypothesis) -> bool:
    turn = abs(float(wrap_angle(place.theta - other.theta)))
    return hypot(place.x - other.x, place.y - other.y) <= APART_M and turn <= APART_RAD
