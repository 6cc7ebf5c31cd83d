"""What a filter asks of a measurement model."""

from typing import Protocol, TypeVar

from dynpf.se2 import FloatArray

__all__ = ["MeasurementModel"]

ReadingT_contra = TypeVar("ReadingT_contra", contravariant=True)


class MeasurementModel(Protocol[ReadingT_contra]):
    """Compares one kind of reading with what each particle, a column of a (D, N) array, would have seen."""

    def log_likelihood(self, particles: FloatArray, reading: ReadingT_contra) -> FloatArray:
        """Return log p(reading | particle), shape (N,): -inf where impossible, zeros where it tells nothing."""

    def plausible(self, particles: FloatArray, weights: FloatArray, reading: ReadingT_contra) -> bool:
        """Return whether the reading can be believed, given what the weighted particles expect."""
