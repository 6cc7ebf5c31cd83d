"""Lines extracted from a scan and matched with the segments of a map: TURTLEBOT's whole weighting step."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.maps.segments import SegmentMap
from dynpf.measurement.lines import Lines, PolarLines, PolarLinesParams
from dynpf.measurement.scan import Scan
from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines
from dynpf.se2 import Floats

__all__ = ["ScanLines", "ScanLinesParams"]


class ScanLinesParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="scan_lines"
):
    """How lines are found, how they are compared, and what they count."""

    extraction: SplitAndMergeParams = SplitAndMergeParams()
    lines: PolarLinesParams = PolarLinesParams(sigma_along=0.2)
    # Exponent of the product: lines of one scan share their errors, so each counts for less than if it stood alone.
    tempering: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0


class ScanLines:
    """The model of a scan that looks at nothing but straight walls: beams that belong to none tell nothing."""

    def __init__(self, params: ScanLinesParams, segment_map: SegmentMap) -> None:
        """Raises ValueError for a parameter out of its range."""
        self.params = params
        self.polar = PolarLines(params.lines, segment_map)

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
        total = self.polar.log_likelihood(particles, lines)
        if self.params.tempering != 1.0:
            total *= np.float32(self.params.tempering)
        return total

    def example(self) -> Scan:
        """Return a scan of a wall 1 m ahead."""
        angles = np.linspace(-0.5, 0.5, 51, dtype=np.float32)
        return Scan(angles, (1.0 / np.cos(angles)).astype(np.float32), 0.0, 10.0)
