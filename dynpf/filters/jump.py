"""The robot may have been set down anywhere: how likely that is, judged against staying on the track."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from dynpf.filters.adaptation import Doubt, uninformative
from dynpf.filters.cloud import Cloud
from dynpf.filters.search import Places, Search
from dynpf.params import validated
from dynpf.portable import exp, log
from dynpf.types import Count, OpenShare, Positive

__all__ = ["Jump", "JumpMemory", "JumpParams"]


HALF = 0.5
"""The share of the particles from which on the robot is more likely to have been set down than not."""

_MOST_DOUBLINGS = 60
"""Of the wait between searches: so many updates never pass."""


class JumpParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="jump"):
    """How often the robot is carried off, and when it is worth while to search the map for it."""

    probability: OpenShare = 1e-4  # at each update, of the robot having been set down anywhere
    drop: Positive = 6.0  # nats that an update's log-evidence falls below the usual, then the map is searched
    # Of a reading, natural logarithm: below it nothing is explained, however usual that is. It depends on the
    # measurement model, so there is none by default.
    log_likelihood_lost: float | None = None
    alpha: OpenShare = 0.05  # of the way from the usual log-evidence to the newest, at each update
    patience: Count = 16  # most updates between searches that find nothing


class JumpMemory(NamedTuple):
    """What a Jump remembers: the usual log-evidence of a reading, and the searches since it was last reached."""

    usual: float
    updates: float  # that it is the mean of
    gain: float = 0.0  # nats by which the best places explained the readings better than the particles did
    unfit: float = 0.0  # searches in a row that found no place which explains the readings as usual
    wait: float = 0.0  # updates until the next search
    share: float = 0.0  # of the particles, set down elsewhere at the last update


class Jump:
    """A motion that now and then ends anywhere on the map, and Bayes' rule for whether it just has.

    The particles stand for the robot that stayed on its track, a Search of the map for one that was set down anywhere.
    The share of the particles that the second is worth is

        share = p E_anywhere / (p E_anywhere + (1 - p) E_particles),

    where E are the mean likelihoods of the readings over either. A robot that may have been set down some updates ago
    is counted with what the best places have gained on the particles since, less ``drop`` an update. As a search takes
    long, none is made while the particles explain the readings as well as they usually do, less ``drop``: the second
    can win only if its evidence is higher than theirs by 1 / p. Where nowhere on the map explains the readings as
    usual it is the map that does not fit, or something is in the way: searches then are repeated after 2, 4, 8 ...
    updates. What is usual is found out at the first update, from the best place on the map, and then averaged.
    """

    def __init__(self, params: JumpParams, search: Search) -> None:
        self.params = validated(params)
        self.search = search

    def begin(self) -> tuple[float, ...]:
        """Return the memory of having seen nothing."""
        return ()

    def doubt(self, cloud: Cloud, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        """See Rescuer; the memory is a JumpMemory, or empty."""
        if uninformative(log_evidence, count):
            return Doubt(cloud.memory, 0.0, self.search)
        known = JumpMemory(*cloud.memory) if cloud.memory else None
        doubt = (
            self._doubt(known, log_evidence, count, readings) if known else self._first(log_evidence, count, readings)
        )
        if doubt.share * cloud.weights.size < HALF:
            doubt = doubt._replace(share=0.0)  # worth no particle
        if known is None or known.share > HALF:
            return doubt
        # Those set down at the last update are the last of the particles; they may have grown to be most of the weight.
        grown = np.sum(cloud.weights[cloud.weights.size - round(known.share * cloud.weights.size) :], dtype=np.float64)
        return doubt._replace(jumped=max(doubt.jumped, float(grown)))

    def _first(self, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        places = self.search.places(readings)
        usual = max(log_evidence, places.log_likelihood - self.params.drop) / count
        return self._judged(JumpMemory(usual, 1.0), log_evidence, places)

    def _doubt(self, known: JumpMemory, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        least = known.usual * count - self.params.drop
        if self.params.log_likelihood_lost is not None:
            least = max(least, self.params.log_likelihood_lost * count)
        averaged = self._averaged(known, max(log_evidence, least) / count)
        if log_evidence >= least:
            return Doubt(averaged, 0.0, self.search)
        if known.wait > 0.0:
            waiting = averaged._replace(gain=known.gain, unfit=known.unfit, wait=known.wait - 1.0)
            return Doubt(waiting, 0.0, self.search, unfit=int(known.unfit))
        places = self.search.places(readings)
        gain, unfit = known.gain, 0.0
        if places.log_likelihood < least:
            gain, unfit = 0.0, known.unfit + 1.0
        wait = min(math.ldexp(1.0, min(int(unfit), _MOST_DOUBLINGS)), float(self.params.patience)) - 1.0
        return self._judged(averaged._replace(gain=gain, unfit=unfit, wait=wait), log_evidence, places)

    def _judged(self, memory: JumpMemory, log_evidence: float, places: Places) -> Doubt:
        """Return the doubt after a search; what it finds is remembered unless the particles are given up for it."""
        drop, prior = self.params.drop, self.params.probability / (1.0 - self.params.probability)
        odds = log(prior) + memory.gain + places.log_evidence - log_evidence
        share = 1.0 / (1.0 + exp(min(-odds, 700.0)))
        if share > HALF:
            memory = memory._replace(gain=0.0, unfit=0.0, wait=0.0)
        elif memory.unfit == 0.0:
            memory = memory._replace(gain=memory.gain + max(places.log_likelihood - drop - log_evidence, 0.0))
        return Doubt(memory._replace(share=share), share, places, places, int(memory.unfit), share)

    def _averaged(self, memory: JumpMemory, newest: float) -> JumpMemory:
        rate = max(self.params.alpha, 1.0 / (memory.updates + 1.0))
        return JumpMemory(memory.usual + rate * (newest - memory.usual), memory.updates + 1.0)
