"""What a filter asks of a measurement model."""

from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynpf.types import Floats

__all__ = ["Batched", "GaussianMeasurement", "MeasurementModel"]

ReadingT_contra = TypeVar("ReadingT_contra", contravariant=True)


class MeasurementModel(Protocol[ReadingT_contra]):
    """Compares one kind of reading with what each particle, a column of a (D, N) array, would have seen."""

    def admit(self, particles: Floats, weights: Floats, reading: ReadingT_contra) -> Any | None:
        """Return the part of the reading that can be believed, given what the weighted particles (N,) expect.

        None where nothing can: not a number, outside the gate, or of nothing in the map. It may be a reading again, or
        whatever the model makes of one to compare it faster: the other methods take it in place of the reading.
        """

    def log_likelihood(self, particles: Floats, reading: ReadingT_contra) -> Floats:
        """Return log p(reading | particle), shape (N,): -inf where impossible, zeros without information."""


@runtime_checkable
class Batched(Protocol):
    """A measurement model whose readings hold several of a kind: the beams of a scan, the landmarks of a glance.

    The likelihood of a batch falls with its size; who compares likelihoods over time needs to know it.
    """

    def count(self, reading: Any) -> int:
        """Return how many readings there are in what ``admit`` has returned."""


class GaussianMeasurement(MeasurementModel[ReadingT_contra], Protocol[ReadingT_contra]):
    """A reading of M numbers that is an expectation h(x) plus Gaussian noise."""

    def innovation(self, states: Floats, reading: ReadingT_contra) -> Floats:
        """Return reading minus h(x) at the states (D, N), angles the short way round, shape (M, N)."""

    def jacobian(self, states: Floats, reading: ReadingT_contra) -> Floats:
        """Return dh/dx at the states (D, N), shape (M, D, N)."""

    def noise(self, reading: ReadingT_contra) -> Floats:
        """Return the covariance of the reading, shape (M, M)."""

    def angular(self, reading: ReadingT_contra) -> NDArray[np.bool_]:
        """Return which of the M numbers are angles, shape (M,)."""
