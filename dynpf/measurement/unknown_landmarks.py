"""Ranges and bearings to landmarks that cannot be told from one another."""

from typing import Annotated, Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.maps.landmarks import LandmarkMap
from dynpf.measurement.range_bearing import RangeBearingReadings, SightingNoise
from dynpf.params import validated
from dynpf.types import Floats, NonNegative, Positive, Rate

__all__ = ["UnknownLandmarks", "UnknownLandmarksParams", "UnlabelledReadings"]


class UnlabelledReadings(NamedTuple):
    """Landmarks seen at one instant: distances (m) and directions from the heading (rad), each (K,)."""

    ranges: Floats
    bearings: Floats


ReadingsT = TypeVar("ReadingsT", UnlabelledReadings, RangeBearingReadings)


class UnknownLandmarksParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="unknown_landmarks"
):
    """Association, noise and trust. The range's variance is sigma_range^2 + (sigma_range_per_m range)^2.

    The defaults of the noise are those of RangeBearingParams, chosen on two data sets of UTIAS MRCLAM.
    """

    # What a reading is of, for each particle: the landmark of maximum likelihood, or any of them with equal chance.
    association: Literal["nearest", "mixture"] = "nearest"
    sigma_range: Positive = 0.08  # m, at range zero
    sigma_range_per_m: NonNegative = 0.2  # m per m
    sigma_bearing: Positive = 0.018  # rad
    # Share of readings that are of no landmark in the map: keeps clutter from ruling a particle out.
    outlier_fraction: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.05
    outlier_range: Positive = 10.0  # m: an outlier's range is uniform up to here, its bearing over the circle
    # Exponent of the likelihood: readings in quick succession share their error, so each counts for less.
    tempering: Rate = 0.35


class UnknownLandmarks:
    """As ``RangeBearing``, but each reading is compared with every landmark; identities, where given, are ignored.

    A reading that is not finite carries no information: it is not admitted and adds zero to the log-likelihood of every
    particle. The same holds for all readings when the map has no landmark.
    """

    def __init__(self, params: UnknownLandmarksParams, landmarks: LandmarkMap | Floats) -> None:
        """Take a map, or positions alone (2, M) in metres; raises ValueError for a parameter out of its range."""
        self.params = validated(params)
        positions = landmarks.positions if isinstance(landmarks, LandmarkMap) else landmarks
        self._positions = np.array(positions, dtype=np.float32, order="C")
        noise = SightingNoise(
            params.sigma_range,
            params.sigma_range_per_m,
            params.sigma_bearing,
            params.outlier_fraction,
            params.outlier_range,
            params.tempering,
        )
        self._noise = np.array(noise)

    def admit(self, particles: Floats, weights: Floats, reading: ReadingsT) -> ReadingsT | None:  # noqa: ARG002
        """Return the readings that carry information, None if there is none: any landmark may explain any of them."""
        ranges, bearings = _arrays(reading)
        kept = np.isfinite(ranges) & np.isfinite(bearings)
        if not (kept.any() and self._positions.size):
            return None
        if kept.all():
            return reading
        if isinstance(reading, RangeBearingReadings):
            return reading.only(kept)
        return UnlabelledReadings(*(np.asarray(values)[kept] for values in reading))

    def count(self, reading: UnlabelledReadings | RangeBearingReadings) -> int:
        """Return the number of landmarks."""
        return len(reading.ranges)

    def log_likelihood(self, particles: Floats, reading: UnlabelledReadings | RangeBearingReadings) -> Floats:
        """Return the tempered log-density of all the readings for each particle, shape (N,), float32.

        Finite wherever there is a share of outliers. Raises ValueError where the readings' arrays differ in length.
        """
        poses = np.ascontiguousarray(particles[:3], dtype=np.float32)
        readings = _arrays(reading)
        out = np.zeros(poses.shape[1], dtype=np.float32)
        if self._positions.size:
            mixture = self.params.association == "mixture"
            kernels.landmarks.log_likelihood_unlabelled(poses, readings, self._positions, mixture, self._noise, out)
        return out


def _arrays(reading: UnlabelledReadings | RangeBearingReadings) -> NDArray[np.float32]:
    """Return ranges and bearings (2, K) as the kernel takes them, copied: a read-only array would compile again."""
    return np.array((reading.ranges, reading.bearings), dtype=np.float32)
