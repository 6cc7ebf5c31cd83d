"""Clearances of discs, walls and points, and the step nearest to a wanted one that meets the bounds they set."""

import numpy as np

from dynpf.kernels import linear
from dynpf.kernels.compiler import device, kernel

__all__ = ["disc_bounds", "project", "to_segments"]

_solve = linear.solve


@kernel
def disc_bounds(centre, radius, others, radii, half_size, rows, clearances):
    """Fill ``rows`` (n + 4, 2) and ``clearances`` (n + 4,) of a disc from ``others`` (n, 2), then from the walls.

    A row points to where the clearance grows. The walls are at +x, +y, -x, -y.
    """
    count = len(others)
    for i in range(count):
        x, y = centre[0] - others[i, 0], centre[1] - others[i, 1]
        length = np.sqrt(x * x + y * y)
        clearances[i] = length - (radius + radii[i])
        # Two discs with one centre have no normal: any direction leads out.
        rows[i, 0] = x / length if length > 0.0 else 1.0
        rows[i, 1] = y / length if length > 0.0 else 0.0
    for wall in range(4):
        axis, side = wall & 1, (-1.0 if wall < 2 else 1.0)
        rows[count + wall, :] = 0.0
        rows[count + wall, axis] = side
        clearances[count + wall] = half_size[axis] + side * centre[axis] - radius


@kernel
def to_segments(x, y, segments):
    """Return the distance from a point to the nearest of ``segments`` (S, 4), rows x1, y1, x2, y2; inf without any."""
    nearest = np.inf
    for i in range(len(segments)):
        along_x, along_y = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
        from_x, from_y = x - segments[i, 0], y - segments[i, 1]
        squared = along_x * along_x + along_y * along_y
        fraction = (from_x * along_x + from_y * along_y) / squared if squared > 0.0 else 0.0
        fraction = min(max(fraction, 0.0), 1.0)
        apart_x, apart_y = from_x - fraction * along_x, from_y - fraction * along_y
        nearest = min(nearest, apart_x * apart_x + apart_y * apart_y)
    return np.sqrt(nearest)


@kernel
def project(step, rows, required, tolerance, out):
    """Fill ``out`` (d,) with argmin ||u - step|| subject to rows (n, d) @ u >= required; return whether there is one.

    Bounds are taken up one at a time, the most violated first: the nearest step that meets some of the bounds and
    happens to meet all of them is the nearest that meets all.
    """
    count, size = rows.shape
    gram, right = np.empty((size, size, size)), np.empty((size, 1))
    taken, number = np.empty(count, dtype=np.int64), 0
    active = np.empty(size, dtype=np.int64)
    out[:] = step
    while True:
        worst, least = 0, np.inf
        for i in range(count):
            slack = _dot(rows[i], out) - required[i]
            if slack < least:
                worst, least = i, slack
        if least >= -tolerance:
            return True
        for i in range(number):
            if taken[i] == worst:
                return False
        taken[number] = worst
        number += 1
        if not _nearest(step, rows, required, tolerance, taken[:number], active, gram, right, out):
            return False


@device
def _nearest(step, rows, required, tolerance, taken, active, gram, right, out):
    """Solve the projection for a handful of bounds by trying each set of them as the active one."""
    for size in range(1, min(out.size, taken.size) + 1):
        for i in range(size):
            active[i] = i
        while True:
            if _met(step, rows, required, tolerance, taken, active[:size], gram, right, out):
                return True
            # The next set: the last index that can still move on does, and those behind it follow.
            index = size - 1
            while index >= 0 and active[index] == taken.size - size + index:
                index -= 1
            if index < 0:
                break
            active[index] += 1
            for i in range(index + 1, size):
                active[i] = active[i - 1] + 1
    return False


@device
def _met(step, rows, required, tolerance, taken, active, gram, right, out):
    """Fill ``out`` with the nearest step that has the active bounds met exactly; return whether that is all right."""
    size = active.size
    normal, multipliers = gram[:1, :size, :size], right[:size].reshape(1, size, 1)
    for i in range(size):
        row = taken[active[i]]
        multipliers[0, i, 0] = required[row] - _dot(rows[row], step)
        for j in range(size):
            normal[0, i, j] = _dot(rows[row], rows[taken[active[j]]])
    if _solve(normal, multipliers) >= 0:
        return False
    determinant = 1.0
    for i in range(size):
        determinant *= normal[0, i, i]
    if abs(determinant) < tolerance:
        return False
    out[:] = step
    for i in range(size):
        if not multipliers[0, i, 0] >= 0.0:
            return False
        for axis in range(out.size):
            out[axis] += multipliers[0, i, 0] * rows[taken[active[i]], axis]
    meets = True
    for i in range(taken.size):
        meets = meets and _dot(rows[taken[i]], out) >= required[taken[i]] - 0.5 * tolerance
    return meets


@device
def _dot(left, right):
    total = 0.0
    for axis in range(left.size):
        total += left[axis] * right[axis]
    return total
