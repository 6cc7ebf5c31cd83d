"""Exact Euclidean distances to walls (Meijster, Roerdink, Hesselink: A general algorithm for computing distance
transforms in linear time, 2000), in whole numbers alone.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["squared_distances"]


@kernel
def squared_distances(occupied, far):
    """Return the squared distances in cells, int32 (H, W), to the nearest true cell; ``far`` if there is none.

    First the distance along each column; then, along each row, every column's wall spans the parabola
    f_u(x) = (x - u)^2 + column[u]^2, and the lower envelope of all of them is the answer.
    """
    height, width = occupied.shape
    column = _along_columns(occupied)
    squared = np.empty((height, width), dtype=np.int32)
    vertex = np.empty(width, dtype=np.int64)
    start = np.empty(width + 1, dtype=np.int64)
    for row in range(height):
        count = 0
        for u in range(width):
            if column[row, u] >= height:
                continue
            own = np.int64(column[row, u]) ** 2
            begin = 0
            while count > 0:
                s = vertex[count - 1]
                at = start[count - 1]
                other = np.int64(column[row, s]) ** 2
                if (at - s) ** 2 + other <= (at - u) ** 2 + own:
                    # The last whole x at which s is no farther than u; not negative, since s is nearer at its start.
                    begin = (u * u - s * s + own - other) // (2 * (u - s)) + 1
                    break
                count -= 1
            if begin < width:
                vertex[count] = u
                start[count] = begin
                count += 1
        if count == 0:
            squared[row, :] = far
        start[count] = width
        for piece in range(count):
            s = vertex[piece]
            height_of = np.int32(column[row, s]) ** 2
            for x in range(start[piece], start[piece + 1]):
                away = np.int32(x - s)
                squared[row, x] = away * away + height_of
    return squared


@device
def _along_columns(occupied):
    """Return the distance in rows to the nearest true cell of the same column, ``height`` or more if there is none."""
    height, width = occupied.shape
    distance = np.empty((height, width), dtype=np.int32)
    for x in range(width):
        distance[0, x] = 0 if occupied[0, x] else height
    for row in range(1, height):
        for x in range(width):
            distance[row, x] = 0 if occupied[row, x] else distance[row - 1, x] + 1
    for row in range(height - 2, -1, -1):
        for x in range(width):
            distance[row, x] = min(distance[row, x], distance[row + 1, x] + 1)
    return distance
