"""What a filter asks of a measurement model."""

from typing import Protocol, TypeVar

from dynpf.se2 import Floats

__all__ = ["GaussianMeasurement", "MeasurementModel"]

ReadingT = TypeVar("ReadingT")


class MeasurementModel(Protocol[ReadingT]):
    """Compares one kind of reading with what each particle, a column of a (D, N) array, would have seen."""

    def admit(self, particles: Floats, weights: Floats, reading: ReadingT) -> ReadingT | None:
        """Return the part of the reading that can be believed, given what the weighted particles (N,) expect.

        None where nothing can: not a number, outside the gate, or of nothing in the map.
        """

    def log_likelihood(self, particles: Floats, reading: ReadingT) -> Floats:
        """Return log p(reading | particle), shape (N,): -inf where impossible, zeros where it tells nothing."""


class GaussianMeasurement(MeasurementModel[ReadingT], Protocol[ReadingT]):
    """A reading of M numbers that is an expectation h(x) plus Gaussian noise."""

    def innovation(self, states: Floats, reading: ReadingT) -> Floats:
        """Return reading minus h(x) at the states (D, N), angles the short way round, shape (M, N)."""

    def jacobian(self, states: Floats, reading: ReadingT) -> Floats:
        """Return dh/dx at the states (D, N), shape (M, D, N)."""

    def noise(self, reading: ReadingT) -> Floats:
        """Return the covariance of the reading, shape (M, M)."""
