"""Ranges and bearings to landmarks whose identities the readings tell (LANDMARK section 5)."""

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.maps.landmarks import LandmarkMap
from dynpf.params import validated
from dynpf.portable import hypot, sincos
from dynpf.portable.functions import as_values
from dynpf.rng import Stream
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats, NonNegative, Positive, Rate

__all__ = ["RangeBearing", "RangeBearingParams", "RangeBearingReadings", "SensorRows"]


class RangeBearingReadings(NamedTuple):
    """Landmarks seen at one instant: identities, distances (m) and directions from the heading (rad), each (K,).

    ``places`` (2, K) in metres are where landmarks that move were then, NaN for those of the map; None: none moves.
    """

    landmarks: NDArray[np.integer[Any]]
    ranges: Floats
    bearings: Floats
    places: Floats | None = None

    def only(self, kept: NDArray[np.bool_]) -> "RangeBearingReadings":
        """Return the readings for which ``kept`` (K,) is true."""
        landmarks, ranges, bearings = (np.asarray(values)[kept] for values in self[:3])
        return RangeBearingReadings(landmarks, ranges, bearings, None if self.places is None else self.places[:, kept])


class RangeBearingParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="range_bearing"
):
    """Noise and trust. The range's variance is sigma_range^2 + (sigma_range_per_m range)^2.

    The defaults were chosen on data sets 7 and 9 of UTIAS MRCLAM, whose barcodes small robots read by camera: they are
    of that sensor, and no more than a start for another one.
    """

    sigma_range: Positive = 0.08  # m, at range zero
    sigma_range_per_m: NonNegative = 0.2  # m per m
    sigma_bearing: Positive = 0.018  # rad
    # Squared Mahalanobis distance of the innovation above which a reading is taken for a misread identity.
    gate: Positive | None = 25.0
    # Share of readings that come from anywhere: keeps one bad reading from deciding.
    outlier_fraction: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.01
    outlier_range: Positive = 10.0  # m: an outlier's range is uniform up to here, its bearing over the circle
    # Exponent of the likelihood: readings in quick succession share their error, so each counts for less.
    tempering: Rate = 0.35


class SensorRows(NamedTuple):
    """Rows of a state that calibrate the sensor: what is added to each bearing (rad), what multiplies each range."""

    bearing_bias: int
    range_scale: int


class Sighted(NamedTuple):
    """Readings as the kernels take them, (K,) each: int64, and float32 in metres and radians."""

    landmarks: NDArray[np.int64]
    ranges: NDArray[np.float32]
    bearings: NDArray[np.float32]


class Marks(NamedTuple):
    """The map's landmarks as the kernels take them: (M,) int64, and (2, M) float32 in metres."""

    ids: NDArray[np.int64]
    positions: Floats


class SightingNoise(NamedTuple):
    """Noise of ranges and bearings, see RangeBearingParams, in the order in which the kernels take it as an array."""

    sigma_range: float
    sigma_range_per_m: float
    sigma_bearing: float
    outlier_fraction: float
    outlier_range: float
    tempering: float


class RangeBearing:
    """Independent Gaussian errors of range and bearing, a uniform share of outliers, and an innovation gate.

    A reading that is not finite, or names a landmark outside the map, carries no information: it is not admitted and
    adds zero to the log-likelihood of every particle. States with ``rows`` calibrate the sensor themselves.
    """

    def __init__(self, params: RangeBearingParams, landmarks: LandmarkMap, rows: SensorRows | None = None) -> None:
        """Raises ValueError for a parameter out of its range."""
        self.params = validated(params)
        self.rows = rows
        self.landmarks = landmarks
        positions = np.array(landmarks.positions, dtype=np.float32, order="C")
        self._marks = Marks(np.array(landmarks.ids, dtype=np.int64), positions)
        noise = SightingNoise(
            params.sigma_range,
            params.sigma_range_per_m,
            params.sigma_bearing,
            params.outlier_fraction,
            params.outlier_range,
            params.tempering,
        )
        self._noise = np.array(noise)

    def admit(self, particles: Floats, weights: Floats, reading: RangeBearingReadings) -> RangeBearingReadings | None:
        """Return the readings that carry information and lie within the gate, None if there is none.

        A reading is within the gate when its mean innovation over the weighted particles is. Its covariance is the
        spread of the particles' expectations plus the noise of the reading, so a filter that is unsure of its pose
        accepts what a sure one refuses. Raises ValueError where arrays differ in length.
        """
        gate = self.params.gate
        kept = self._informs(reading) if gate is None else self._distances(particles, weights, reading) <= gate
        if kept.all():
            return reading if kept.size else None
        if not kept.any():
            return None
        return reading.only(kept)

    def count(self, reading: RangeBearingReadings) -> int:
        """Return the number of landmarks."""
        return len(reading.ranges)

    def log_likelihood(self, particles: Floats, reading: RangeBearingReadings) -> Floats:
        """Return the tempered log-density of all the readings for each particle, shape (N,), float32.

        Finite wherever there is a share of outliers. Raises ValueError where the readings' arrays differ in length.
        """

        def of(poses: Floats, sighted: Sighted) -> NDArray[np.float32]:
            out = np.empty(poses.shape[1], dtype=np.float32)
            kernels.landmarks.log_likelihood(poses, *sighted, *marks, self._noise, out)
            return out

        sighted, marks = self._located(reading)
        if self.rows is None:
            return of(np.ascontiguousarray(particles[:3], dtype=np.float32), sighted)
        total = np.zeros(particles.shape[1], dtype=np.float32)
        for poses, each in self._one_by_one(particles, sighted, marks):
            total += of(poses, each)
        return total

    def innovation(self, states: Floats, reading: RangeBearingReadings) -> Floats:
        """Return range (m) and bearing (rad, the short way) of each reading less their expectations, shape (2K, N).

        Row 2k is the range of reading k and row 2k + 1 its bearing. Raises KeyError for a landmark outside the map.
        """
        ranges, bearings = as_values(reading.ranges), as_values(reading.bearings)
        if ranges.shape != bearings.shape:
            raise ValueError(
                f"ranges of shape {ranges.shape} and bearings of shape {bearings.shape}: expected one shape"
            )
        errors = np.empty((2 * ranges.size, states.shape[1]))
        where = _poses(states), *self._places(reading)
        kernels.landmarks.innovations(*where, ranges, bearings, *self._calibrated(states), errors)
        return errors.astype(states.dtype, copy=False)

    def jacobian(self, states: Floats, reading: RangeBearingReadings) -> Floats:
        """Return the derivatives of the expectations by the states (D, N), shape (2K, D, N); rows as in innovation.

        At a landmark, where they do not exist, those by x and y are zero. Raises KeyError for a landmark outside the
        map.
        """
        derivatives = np.zeros((2 * len(reading.ranges), *states.shape))
        kernels.landmarks.slopes(_poses(states), *self._places(reading), *self._calibrated(states), derivatives)
        return derivatives.astype(states.dtype, copy=False)

    def noise(self, reading: RangeBearingReadings) -> Floats:
        """Return the covariance (m^2, rad^2) of the readings, shape (2K, 2K), outliers left aside.

        It is divided by the tempering: a Gaussian to the power t is, but for a constant, one of variance 1/t as large.
        """
        params = self.params
        variances = np.empty(2 * len(reading.ranges))
        variances[0::2] = params.sigma_range * params.sigma_range + np.square(
            params.sigma_range_per_m * np.asarray(reading.ranges)
        )
        variances[1::2] = params.sigma_bearing * params.sigma_bearing
        return np.diag(variances / params.tempering)

    def angular(self, reading: RangeBearingReadings) -> NDArray[np.bool_]:
        """Return which rows of the innovation are angles: every second one, the bearings, shape (2K,)."""
        return np.tile((False, True), len(reading.ranges))

    def poses(self, reading: RangeBearingReadings, count: int, stream: Stream) -> NDArray[np.float32]:
        """Return poses (3, count) from which the first reading that carries information could have been seen.

        They stand in a ring about the landmark, anywhere on it, as far away as the range and turned as the bearing
        tells, both with their noise. Raises ValueError where no reading carries information.
        """
        informative = np.flatnonzero(self._informs(reading))[:1]
        if not informative.size:
            raise ValueError(f"none of the {len(reading.ranges)} readings is finite and of a landmark in the map")
        _, distance, bearing = (values[informative[0]] for values in reading[:3])
        params = self.params
        noise = stream.normals(2, count).astype(np.float64)
        direction = 2.0 * np.pi * stream.part("ring").uniforms(1, count)[0].astype(np.float64)
        distances = distance + hypot(params.sigma_range, float(params.sigma_range_per_m * distance)) * noise[0]
        east, north = self._places(reading.only(np.arange(len(reading.ranges)) == informative[0]))[:, 0]
        sine, cosine = sincos(direction)
        x, y = east - distances * cosine, north - distances * sine
        theta = wrap_angle(direction - bearing - params.sigma_bearing * noise[1])
        return np.stack((x, y, theta)).astype(np.float32)

    def _distances(self, particles: Floats, weights: Floats, reading: RangeBearingReadings) -> Floats:
        """Return the squared Mahalanobis distance of each reading's mean innovation (K,), NaN without information."""
        if weights.shape != particles.shape[1:]:
            raise ValueError(f"weights of shape {weights.shape} for {particles.shape[1]} particles")
        shares = np.ascontiguousarray(weights, dtype=np.float32)

        def of(poses: Floats, sighted: Sighted) -> FloatArray:
            out = np.empty(sighted.ranges.size)
            kernels.landmarks.distances(poses, shares, *sighted, *marks, self._noise, out)
            return out

        sighted, marks = self._located(reading)
        if self.rows is None:
            return of(np.ascontiguousarray(particles[:3], dtype=np.float32), sighted)
        distances = [of(poses, each) for poses, each in self._one_by_one(particles, sighted, marks)]
        return np.concatenate(distances) if distances else np.empty(0)

    def _one_by_one(self, particles: Floats, sighted: Sighted, marks: Marks) -> Iterator[tuple[Floats, Sighted]]:
        """Yield each reading, and the poses (3, N) whose own sensor, uncalibrated, would read as the particles' does.

        They are as much farther from the landmark as the range is scaled, and turned against the bias. So one kernel
        does for both; a landmark that is not in the map leaves the poses where they are.
        """
        scale, bias = self._calibration(particles)
        for k, landmark in enumerate(sighted.landmarks.tolist()):
            poses = np.array(particles[:3], dtype=np.float32, order="C")
            for mark in np.flatnonzero(marks.ids == landmark)[:1]:
                for row, axis in enumerate(marks.positions):
                    poses[row] = axis[mark] + scale * (poses[row] - axis[mark])
            poses[2] -= bias
            kept = slice(k, k + 1)
            yield poses, Sighted(sighted.landmarks[kept], sighted.ranges[kept], sighted.bearings[kept])

    def _calibration(self, states: Floats) -> tuple[Floats | float, Floats | float]:
        """Return what multiplies ranges and what is added to bearings; of mere poses, nothing is known of either."""
        if self.rows is None or len(states) <= max(self.rows):
            return 1.0, 0.0
        return states[self.rows.range_scale], states[self.rows.bearing_bias]

    def _informs(self, reading: RangeBearingReadings) -> NDArray[np.bool_]:
        landmarks, ranges, bearings = _arrays(reading)
        known = np.array([landmark in self.landmarks for landmark in landmarks.tolist()], dtype=np.bool_)
        known |= _moving(reading)
        return known & np.isfinite(ranges) & np.isfinite(bearings)

    def _calibrated(self, states: Floats) -> tuple[int, int]:
        """Return the rows of the states by which bearings are off and ranges scaled; -1 where they have none."""
        return (-1, -1) if self.rows is None or len(states) <= max(self.rows) else self.rows

    def _places(self, reading: RangeBearingReadings) -> FloatArray:
        """Return where the landmark of each reading is, shape (2, K); raises KeyError for one outside the map."""
        places = np.empty((2, len(reading.ranges)))
        for k, (landmark, moving) in enumerate(zip(reading.landmarks, _moving(reading).tolist(), strict=True)):
            positions = reading.places
            places[:, k] = (
                positions[:, k] if moving and positions is not None else self.landmarks.position(int(landmark))
            )
        return places

    def _located(self, reading: RangeBearingReadings) -> tuple[Sighted, Marks]:
        """Return the readings and the landmarks as the kernels take them.

        Of a landmark that moves, each reading has an identity of its own, for which the map has none: below zero.
        """
        sighted = _arrays(reading)
        if reading.places is None:
            return sighted, self._marks
        moving = np.flatnonzero(_moving(reading))
        own = -1 - np.arange(moving.size)
        ids = sighted.landmarks.copy()
        ids[moving] = own
        known = self._marks
        added = np.asarray(reading.places[:, moving], dtype=np.float32)
        marks = Marks(np.concatenate([known.ids, own]), np.concatenate([known.positions, added], axis=1))
        return sighted._replace(landmarks=ids), marks


def _poses(states: Floats) -> FloatArray:
    """Return states (D, N) as the kernels take them; raises ValueError where there is no heading among them."""
    if len(states) < 3:
        raise ValueError(f"states of shape {states.shape}: expected x, y and theta at least")
    return as_values(states)


def _moving(reading: RangeBearingReadings) -> NDArray[np.bool_]:
    """Return a mask (K,) of the readings whose landmark moves."""
    if reading.places is None:
        return np.zeros(len(reading.ranges), dtype=np.bool_)
    return np.asarray(np.isfinite(reading.places).all(axis=0), dtype=np.bool_)


def _arrays(reading: RangeBearingReadings) -> Sighted:
    """Return the readings as the kernels take them; raises ValueError where the arrays differ in length."""
    landmarks = _array(reading.landmarks, np.dtype(np.int64))
    ranges, bearings = _array(reading.ranges, np.dtype(np.float32)), _array(reading.bearings, np.dtype(np.float32))
    if not landmarks.shape == ranges.shape == bearings.shape:
        sizes = f"{landmarks.size} landmarks, {ranges.size} ranges and {bearings.size} bearings"
        raise ValueError(f"{sizes}: a reading needs one of each")
    return Sighted(landmarks, ranges, bearings)


def _array(values: ArrayLike, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return an array as it is if the kernels take it, else a copy: for a read-only one they would compile again."""
    if isinstance(values, np.ndarray) and values.dtype == dtype:
        flags = values.flags
        if flags.writeable and flags.c_contiguous:
            return values
    return np.array(values, dtype=dtype)
