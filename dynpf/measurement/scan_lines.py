"""Lines extracted from a scan and matched with the segments of a map: TURTLEBOT's whole weighting step."""

import msgspec
import numpy as np

from dynpf.maps.raycast import RayCaster
from dynpf.maps.segments import SegmentMap
from dynpf.measurement.lines import Lines, PolarLines, PolarLinesParams
from dynpf.measurement.scan import Scan
from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines
from dynpf.params import validated
from dynpf.portable import atan2, cos, hypot
from dynpf.types import Floats, Positive, Rate

__all__ = ["ScanLines", "ScanLinesParams"]


class ScanLinesParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="scan_lines"
):
    """How lines are found, how they are compared, and what they count."""

    extraction: SplitAndMergeParams = SplitAndMergeParams()
    lines: PolarLinesParams = PolarLinesParams(sigma_along=0.2)
    # Exponent of the product: lines of one scan share their errors, so each counts for less than if it stood alone.
    tempering: Rate = 1.0
    # m: a line that a wall of the map hides, nearer by more than this, is an outlier; absent: walls hide nothing.
    hidden: Positive | None = 0.3
    resolution: Positive = 0.05  # m a cell of the grid in which that is found out


class ScanLines:
    """The model of a scan that looks at nothing but straight walls: beams that belong to none carry no information.

    TURTLEBOT takes a line for a wall wherever that is, behind another one, too. Here a ray is cast to the middle of
    what was seen of each line, and where a wall is before it the line is none of the map's for that particle.
    """

    def __init__(self, params: ScanLinesParams, segment_map: SegmentMap) -> None:
        """Raises ValueError for a parameter out of its range."""
        self.params = validated(params)
        self.polar = PolarLines(params.lines, segment_map)
        hides = params.hidden is not None
        self._caster = RayCaster(segment_map.rasterize(params.resolution, 1.5 * params.resolution)) if hides else None

    def admit(self, particles: Floats, weights: Floats, reading: Scan) -> Lines | None:
        """Return the lines in the scan that some segment of the map could be; None if there is none."""
        lines = extract_lines(reading, self.params.extraction)
        return self.polar.admit(particles, weights, lines) if lines.rho.size else None

    def count(self, reading: Lines) -> int:
        """Return the number of lines."""
        return self.polar.count(reading)

    def log_likelihood(self, particles: Floats, reading: Scan | Lines) -> Floats:
        """Return log p(lines | particle) to the power of ``tempering``, shape (N,) float32."""
        lines = extract_lines(reading, self.params.extraction) if isinstance(reading, Scan) else reading
        if self._caster is None or lines.middles is None:
            total = self.polar.log_likelihood(particles, lines)
        else:
            total = np.zeros(particles.shape[1], dtype=np.float32)
            for line in range(lines.rho.size):
                total += self._of_one(particles, Lines(*(np.asarray(row)[line : line + 1] for row in lines)))
        if self.params.tempering != 1.0:
            total *= np.float32(self.params.tempering)
        return total

    def _of_one(self, particles: Floats, line: Lines) -> Floats:
        """Return log p(line | particle): no more than an outlier's where a wall hides it."""
        assert self._caster is not None
        assert self.params.hidden is not None
        assert line.middles is not None
        likelihood = self.polar.log_likelihood(particles, line)
        rho, alpha, middle = float(line.rho[0]), float(line.alpha[0]), float(line.middles[0])
        distance, bearing = hypot(rho, middle), alpha + atan2(middle, rho)
        nearest = distance - self.params.hidden
        if nearest <= 0.0:
            return likelihood
        x, y, theta = np.ascontiguousarray(particles[:3], dtype=np.float32)
        free = self._caster.ranges(x, y, theta + np.float32(bearing), nearest) >= nearest
        return np.where(free, likelihood, np.minimum(likelihood, self.polar.log_outlier))

    def example(self) -> Scan:
        """Return a scan of a wall 1 m ahead."""
        angles = np.linspace(-0.5, 0.5, 51, dtype=np.float32)
        return Scan(angles, (1.0 / cos(angles)).astype(np.float32), 0.0, 10.0)
