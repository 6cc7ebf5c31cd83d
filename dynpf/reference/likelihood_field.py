"""The likelihood field's sum over beams, for ``dynpf.kernels.likelihood_field``."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["sum_over_beams"]

FloatArray = NDArray[np.float64]


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
