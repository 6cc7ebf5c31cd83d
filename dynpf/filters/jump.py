"""The robot may have been set down anywhere: how likely that is, judged against staying on the track."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from dynpf.filters.adaptation import Doubt, tells_nothing
from dynpf.filters.search import Search
from dynpf.params import validated

__all__ = ["Jump", "JumpParams"]

Positive = Annotated[float, Meta(gt=0.0)]
Rate = Annotated[float, Meta(gt=0.0, lt=1.0)]


class JumpParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="jump"):
    """How often the robot is carried off, and when it is worth while to search the map for it."""

    probability: Rate = 1e-4  # at each update, of the robot having been set down anywhere
    drop: Positive = 6.0  # nats that an update's log-evidence falls below the usual, then the map is searched
    alpha: Rate = 0.05  # of the way from the usual log-evidence to the newest, at each update
    patience: Annotated[int, Meta(ge=1)] = 16  # most updates between searches that find nothing better


class Jump:
    """A motion that now and then ends anywhere on the map, and Bayes' rule for whether it just has.

    The particles stand for the robot that stayed on its track, a Search of the map for one that was set down anywhere.
    The share of the particles that the second is worth is

        share = p E_anywhere / (p E_anywhere + (1 - p) E_particles),

    where E are the mean likelihoods of the readings over either. As a search takes long, none is made while the
    particles explain the readings about as well as they usually do: the search then could win only if its evidence
    were higher than theirs by 1 / p. Searches in vain are repeated after 1, 2, 4 ... updates. What is usual is found
    out in the first update, from the best place on the map, and then averaged.

    The memory: usual log-evidence of a reading, updates that it is the mean of, updates to wait until the next
    search, and how long the next wait will be.
    """

    def __init__(self, params: JumpParams, search: Search) -> None:
        self.params = validated(params)
        self.search = search

    def begin(self) -> tuple[float, ...]:
        """Return the memory of having seen nothing."""
        return ()

    def doubt(self, memory: tuple[float, ...], log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        """See Rescue."""
        if tells_nothing(log_evidence, count):
            return Doubt(memory, 0.0, self.search)
        params = self.params
        new = log_evidence / count
        usual, updates, wait, next_wait = memory or (-math.inf, 0.0, 0.0, 1.0)
        low = log_evidence < usual * count - params.drop
        if memory and not low:
            return Doubt(self._remembered(usual, updates, new), 0.0, self.search)
        least = usual - params.drop / count
        if wait > 0.0:
            kept = self._remembered(usual, updates, max(new, least))
            return Doubt((*kept[:2], wait - 1.0, next_wait), 0.0, self.search)
        places = self.search.places(readings)
        odds = math.log(params.probability / (1.0 - params.probability)) + places.log_evidence - log_evidence
        share = 1.0 / (1.0 + math.exp(min(-odds, 700.0)))
        explained = (places.log_likelihood - params.drop) / count
        if not memory:
            return Doubt(self._remembered(0.0, 0.0, max(new, explained)), share, places, places)
        kept = self._remembered(usual, updates, max(new, explained, least))
        if share < 0.5:
            kept = (*kept[:2], next_wait, min(2.0 * next_wait, float(params.patience)))
        return Doubt(kept, share, places, places)

    def _remembered(self, usual: float, updates: float, new: float) -> tuple[float, ...]:
        rate = max(self.params.alpha, 1.0 / (updates + 1.0))
        return usual + rate * (new - usual), updates + 1.0, 0.0, 1.0
