"""Range and bearing to a landmark whose identity the reading tells (LANDMARK section 5)."""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.filters.estimate import weighted_covariance
from dynpf.maps.landmarks import LandmarkMap
from dynpf.se2 import FloatArray, wrap_angle

__all__ = ["RangeBearing", "RangeBearingParams", "RangeBearingReading"]

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]


class RangeBearingReading(NamedTuple):
    """Distance (m) and direction from the heading (rad, anticlockwise) at which a landmark was seen."""

    landmark: int
    range: float
    bearing: float


class RangeBearingParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="range_bearing"
):
    """Noise and trust. The range's variance is sigma_range^2 + (sigma_range_per_m range)^2."""

    sigma_range: Positive = 0.08  # m, at range zero
    sigma_range_per_m: NonNegative = 0.2  # m per m
    sigma_bearing: Positive = 0.018  # rad
    # Squared Mahalanobis distance of the innovation above which a reading is taken for a misread identity.
    gate: Positive = 25.0
    # Share of readings that come from anywhere: keeps one bad reading from deciding.
    outlier_fraction: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.01
    outlier_range: Positive = 10.0  # m: an outlier's range is uniform up to here, its bearing over the circle
    # Exponent of the likelihood: readings in quick succession share their error, so each counts for less.
    tempering: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.35


class RangeBearing:
    """Independent Gaussian errors of range and bearing, a uniform share of outliers, and an innovation gate.

    The map's correspondence is known. A reading that holds a NaN, or names a landmark outside the map, tells
    nothing: its log-likelihood is zero for every particle and it is not plausible.
    """

    def __init__(self, params: RangeBearingParams, landmarks: LandmarkMap) -> None:
        self.params = params
        self.landmarks = landmarks

    def expected(self, particles: FloatArray, landmark: int) -> tuple[FloatArray, FloatArray]:
        """Return the range and bearing, each (N,), at which each particle would see a landmark of the map."""
        x, y = self.landmarks.position(landmark)
        east, north = x - particles[0], y - particles[1]
        bearing = np.arctan2(north, east) - particles[2]
        return np.hypot(east, north), wrap_angle(bearing)

    def innovation(self, particles: FloatArray, reading: RangeBearingReading) -> FloatArray:
        """Return reading minus expectation: range (m) and bearing (rad, the short way), shape (2, N)."""
        ranges, bearings = self.expected(particles, reading.landmark)
        return np.stack((reading.range - ranges, wrap_angle(reading.bearing - bearings)))

    def variances(self, reading: RangeBearingReading) -> FloatArray:
        """Return the variances of range (m^2) and bearing (rad^2), shape (2,)."""
        params = self.params
        return np.array(
            [
                params.sigma_range**2 + (params.sigma_range_per_m * reading.range) ** 2,
                params.sigma_bearing**2,
            ]
        )

    def log_likelihood(self, particles: FloatArray, reading: RangeBearingReading) -> FloatArray:
        """Return the tempered log-density of the reading for each particle, shape (N,)."""
        if not self._tells(reading):
            return np.zeros(particles.shape[1])
        params = self.params
        variances = self.variances(reading)
        error = self.innovation(particles, reading)
        distance = error[0] ** 2 / variances[0] + error[1] ** 2 / variances[1]
        log_density = -0.5 * distance - np.log(2.0 * np.pi * np.sqrt(variances[0] * variances[1]))
        if params.outlier_fraction > 0.0:
            log_outlier = np.log(params.outlier_fraction / (params.outlier_range * 2.0 * np.pi))
            log_density = np.logaddexp(np.log1p(-params.outlier_fraction) + log_density, log_outlier)
        tempered: FloatArray = params.tempering * log_density
        return tempered

    def plausible(self, particles: FloatArray, weights: FloatArray, reading: RangeBearingReading) -> bool:
        """Return whether the particles' mean innovation lies within the gate.

        Its covariance is the spread of the particles' expectations plus the noise of the reading, so a
        filter that is unsure of its pose accepts what a sure one refuses.
        """
        if not self._tells(reading):
            return False
        error = self.innovation(particles, reading)
        mean = np.sum(weights * error, axis=1)
        spread = weighted_covariance(error - mean[:, None], weights)
        covariance = spread + np.diag(self.variances(reading))
        return float(mean @ np.linalg.solve(covariance, mean)) <= self.params.gate

    def _tells(self, reading: RangeBearingReading) -> bool:
        return bool(np.isfinite((reading.range, reading.bearing)).all()) and reading.landmark in self.landmarks
