"""Walls seen as straight lines, matched with the segments of a map (TURTLEBOT, "weighting")."""

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.maps.segments import SegmentMap
from dynpf.params import validated
from dynpf.portable import log, sincos
from dynpf.types import Floats, NonNegative, Positive

__all__ = ["Lines", "PolarLines", "PolarLinesParams"]


class Lines(NamedTuple):
    """Lines seen at one instant, in the robot's frame, each array (K,).

    ``rho`` is the distance (m) from the robot to the line and ``alpha`` (rad) the direction in which it lies, so that
    the line's points satisfy x cos alpha + y sin alpha = rho; ``lengths`` (m) is how much of it was seen, and
    ``middles`` (m), where it is known, how far to the left of the line's nearest point the middle of that lies.
    """

    rho: Floats
    alpha: Floats
    lengths: Floats
    middles: Floats | None = None


class Segments(NamedTuple):
    """The map's segments as the kernel takes them, float32, (S,) each.

    Each lies on the line at the distance ``offsets`` from the origin in the direction ``normals``, with its cosine and
    sine, its middle at ``centres`` along that line, and explains no line longer than ``longest``.
    """

    offsets: Floats
    normals: Floats
    cosines: Floats
    sines: Floats
    longest: Floats
    centres: Floats


class LineNoise(NamedTuple):
    """The noise of a line: see PolarLinesParams; ``sigma_along`` 0 where places do not matter."""

    sigma_rho: float
    sigma_alpha: float
    sigma_along: float
    outlier_fraction: float
    outlier_rho: float


class PolarLinesParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="polar_lines"
):
    """Noise and trust."""

    sigma_rho: Positive = 0.1  # m
    sigma_alpha: Positive = 0.1  # rad
    # m: by how much a line may be longer than a segment of the map and still be taken for it.
    length_tolerance: NonNegative = 0.2
    # m: by how much a line of known middle may reach beyond the segment, tolerance aside; absent: places do not matter.
    sigma_along: Positive | None = None
    # Share of lines that are of nothing in the map: with none, a line too long for every segment rules all out.
    outlier_fraction: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.05
    outlier_rho: Positive = 4.0  # m: an outlier's distance is uniform up to here, its direction over the circle


class PolarLines:
    """Independent Gaussian errors of rho and alpha about the segment of maximum likelihood, for each line.

    No line is taken for a segment that is shorter than it. TURTLEBOT compares carrying lines, so that any parallel wall
    at the same distance will do; with ``sigma_along``, what is seen of a line has to lie where the segment is, too.
    (rho, alpha) and (-rho, alpha + pi) are one line and compared as such. A line with a value that is not finite tells
    nothing: it is not admitted and adds zero to the log-likelihood of every particle.
    """

    def __init__(self, params: PolarLinesParams, segment_map: SegmentMap) -> None:
        """Raises ValueError for a parameter out of its range."""
        self.params = validated(params)
        rho, alpha = segment_map.rho, segment_map.alpha
        longest = segment_map.lengths + params.length_tolerance
        middles = segment_map.segments.reshape(-1, 2, 2).mean(axis=1)
        sine, cosine = sincos(alpha)
        centres = middles[:, 1] * cosine - middles[:, 0] * sine
        columns = (rho, alpha, cosine, sine, longest, centres)
        self._noise = LineNoise(
            params.sigma_rho,
            params.sigma_alpha,
            params.sigma_along or 0.0,
            params.outlier_fraction,
            params.outlier_rho,
        )
        self._segments = Segments(*(column.astype(np.float32) for column in columns))

    @property
    def log_outlier(self) -> np.float32:
        """The log-density of a line that is of nothing in the map; -inf where there is no share of those."""
        fraction = self.params.outlier_fraction
        return np.float32(log(fraction / (math.tau * self.params.outlier_rho)) if fraction > 0.0 else -math.inf)

    def admit(self, particles: Floats, weights: Floats, reading: Lines) -> Lines | None:  # noqa: ARG002
        """Return the lines that are finite and not too long for every segment of the map, None if there is none."""
        lines = _arrays(reading)
        kept = np.isfinite(lines).all(axis=0) & (lines[2] <= np.max(self._segments.longest))
        if not kept.any():
            return None
        if kept.all():
            return reading
        rho, alpha, lengths = (np.asarray(values)[kept] for values in reading[:3])
        return Lines(rho, alpha, lengths, None if reading.middles is None else np.asarray(reading.middles)[kept])

    def count(self, reading: Lines) -> int:
        """Return the number of lines."""
        return len(reading.rho)

    def log_likelihood(self, particles: Floats, reading: Lines) -> Floats:
        """Return the log-density of all the lines for each particle, shape (N,), float32.

        Finite wherever there is a share of outliers. Without, a line too long for every segment makes it -inf for
        every particle. Raises ValueError where the reading's arrays differ in length.
        """
        x, y, theta = np.ascontiguousarray(particles[:3], dtype=np.float32)
        rho, alpha, lengths, *middles = _arrays(reading)
        lines = Lines(rho, alpha, lengths, middles[0] if middles else lengths)
        noise = self._noise if middles else self._noise._replace(sigma_along=0.0)
        out = np.empty(x.size, dtype=np.float32)
        kernels.lines.log_likelihood(x, y, theta, lines, self._segments, noise, out)
        return out


def _arrays(reading: Lines) -> NDArray[np.float32]:
    """Return the lines (3 or 4, K) as the kernel takes them, copied: a read-only array would be compiled for again."""
    return np.array([values for values in reading if values is not None], dtype=np.float32)
