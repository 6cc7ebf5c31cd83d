"""The models that a particle filter is made of, evaluated for all particles, on several threads if wanted.

A model treats every particle by itself, with that particle's own random numbers. So the columns can be dealt out to
threads in any pieces without changing one bit of what comes out.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from dynpf.measurement.model import Batched, MeasurementModel
from dynpf.motion.model import MotionModel
from dynpf.rng import Stream
from dynpf.types import Floats

__all__ = ["Evidence", "Models", "Outcome"]

LEAST_PIECE = 4096
"""Particles below which a thread costs more than it saves."""

# Pieces start at a multiple of the kernels' block.
_BLOCK = 256


class Outcome(StrEnum):
    """The outcome of a reading."""

    USED = "used"
    REFUSED = "refused"  # nothing of it could be believed: outside the gate, not a number, or of nothing in the map
    IMPOSSIBLE = "impossible"  # no particle explains it: the weights stayed as they were


class Evidence(NamedTuple):
    """The believable part of a reading, the model that takes it, and how many readings it holds (see Batched)."""

    model: MeasurementModel[Any]
    reading: Any
    readings: int


class Models:
    """A motion model, a measurement model for each type of reading, and the threads that evaluate them."""

    def __init__(
        self, motion: MotionModel[Any], measurements: Mapping[type, MeasurementModel[Any]], threads: int = 1
    ) -> None:
        """Raises ValueError when ``threads`` is below one."""
        if threads < 1:
            raise ValueError(f"threads = {threads}: expected at least 1")
        self.motion = motion
        self.measurements = dict(measurements)
        self._batched = {taken for taken, model in measurements.items() if isinstance(model, Batched)}
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def propagate(self, particles: Floats, control: Any, stream: Stream) -> Floats:
        """Return draws from p(x | particle, control), shape (D, N)."""
        return self._over_columns(
            particles, lambda piece, first: self.motion.propagate(piece, control, stream.starting_at(first))
        )

    def believable(
        self, particles: Floats, weights: Floats, readings: Sequence[Any]
    ) -> tuple[list[Evidence], list[Outcome]]:
        """Return the believable parts of the readings, and the outcome of each reading.

        Raises TypeError for a type of reading that no measurement model takes.
        """
        evidence, outcomes = [], []
        for reading in readings:
            model = self._model_of(reading)
            admitted = model.admit(particles, weights, reading)
            outcomes.append(Outcome.REFUSED if admitted is None else Outcome.USED)
            if admitted is not None:
                count = model.count(admitted) if type(reading) in self._batched else 1
                evidence.append(Evidence(model, admitted, count))
        return evidence, outcomes

    def log_likelihood(self, particles: Floats, evidence: Sequence[Evidence]) -> Floats:
        """Return log p(all evidence | particle), shape (N,)."""

        def of_piece(piece: Floats, _: int) -> Floats:
            total = evidence[0].model.log_likelihood(piece, evidence[0].reading)
            for other in evidence[1:]:
                total = total + other.model.log_likelihood(piece, other.reading)
            return total

        return self._over_columns(particles, of_piece)

    def _model_of(self, reading: Any) -> Any:
        try:
            return self.measurements[type(reading)]
        except KeyError:
            known = ", ".join(sorted(taken.__name__ for taken in self.measurements)) or "none"
            raise TypeError(
                f"no measurement model takes a {type(reading).__name__}; those given take: {known}"
            ) from None

    def _over_columns(self, particles: Floats, function: Callable[[Floats, int], Floats]) -> Floats:
        """Return function(columns, first column) of all columns, the last axis put together again."""
        count = particles.shape[1]
        pieces = min(self.threads, count // LEAST_PIECE)
        if self._pool is None or pieces < 2:
            return function(particles, 0)
        size = -(-count // (pieces * _BLOCK)) * _BLOCK
        starts = range(0, count, size)
        others = [self._pool.submit(function, particles[:, start : start + size], start) for start in starts[1:]]
        first = function(particles[:, :size], 0)
        return np.concatenate([first, *(other.result() for other in others)], axis=-1)
