"""The likelihood field's sum over beams, for ``dynpf.kernels.likelihood_field``."""

import numpy as np

from dynpf.measurement.scan import Scan
from dynpf.types import FloatArray

__all__ = ["beam_ends", "sum_over_beams"]


def beam_ends(scan: Scan, mount: tuple[float, float, float], cells_per_metre: float, max_beams: int) -> FloatArray:
    """Return where the usable beams with a return end, in cells in the robot's frame, shape (2, B)."""
    returned = scan.ranges < np.float32(scan.range_max)
    angles, ranges, *_ = scan._replace(angles=scan.angles[returned], ranges=scan.ranges[returned]).usable(max_beams)
    direction = angles.astype(np.float64) + mount[2]
    ends: FloatArray = np.stack([mount[0] + ranges * np.cos(direction), mount[1] + ranges * np.sin(direction)])
    return ends * cells_per_metre


def sum_over_beams(
    poses: FloatArray, ends: FloatArray, table: FloatArray, frame: tuple[float, float, float, float]
) -> FloatArray:
    """Return the sum (N,) over beams of the table's values where the beams of poses (3, N) end.

    ``ends`` (2, B) in cells in the robot's frame; ``table`` with a border of one cell; ``frame``: its rotation, offset
    along column and row in cells, and cells a metre.
    """
    turn, column, row, scale = frame
    cosine, sine = np.cos(poses[2] + turn), np.sin(poses[2] + turn)
    columns = (np.cos(turn) * poses[0] - np.sin(turn) * poses[1]) * scale + column
    rows = (np.sin(turn) * poses[0] + np.cos(turn) * poses[1]) * scale + row
    columns = columns[:, None] + np.outer(cosine, ends[0]) - np.outer(sine, ends[1])
    rows = rows[:, None] + np.outer(sine, ends[0]) + np.outer(cosine, ends[1])
    height, width = table.shape
    cells = table[np.clip(rows, 0, height - 1).astype(int), np.clip(columns, 0, width - 1).astype(int)]
    total: FloatArray = cells.sum(axis=1)
    return total
