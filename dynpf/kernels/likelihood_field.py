"""The likelihood field's sum over beams: for each particle, the table's values at the cells where its beams end."""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import log, sincos
from dynpf.kernels.philox import BLOCK

__all__ = ["find_beam_ends", "log_of_one_more", "sum_over_beams"]

_f = np.float32
_TOGETHER = 4  # beams whose cells are looked up in one pass
_ZERO, _ONE, _FAR, _IMPOSSIBLE = _f(0.0), _f(1.0), _f(1e30), _f(-np.inf)


@kernel
def find_beam_ends(angles, ranges, shortest, longest, mount, cells_per_metre, ends_x, ends_y):
    """Write where beams end, in cells in the robot's frame, at most as many as ``ends_x`` holds; return how many.

    Of the beams with a return, no shorter than ``shortest`` and shorter than ``longest`` metres, as many as there is
    room for are taken, evenly spaced, as ``Scan.usable`` does. ``mount`` (3,) is the sensor's pose on the robot.
    """
    scale, turn, room = _f(cells_per_metre), mount[2], ends_x.size
    shortest, longest = _f(shortest), _f(longest)
    usable = 0
    for i in range(ranges.size):
        usable += np.isfinite(angles[i]) and ranges[i] >= shortest and ranges[i] < longest
    taken = min(usable, room)
    seen, written = 0, 0
    for i in range(ranges.size):
        if np.isfinite(angles[i]) and ranges[i] >= shortest and ranges[i] < longest:
            if usable <= room or seen == (2 * written + 1) * usable // (2 * room):
                sine, cosine = sincos(angles[i] + turn)
                ends_x[written] = (mount[0] + ranges[i] * cosine) * scale
                ends_y[written] = (mount[1] + ranges[i] * sine) * scale
                written += 1
            seen += 1
    return taken


@kernel
def sum_over_beams(x, y, theta, ends_x, ends_y, table, frame, out):
    """Write to ``out`` (N,) the sum over beams (B,) of the table's values where the beams of each particle end.

    Beam ends are in cells. ``frame`` (4,) takes the map's frame into the table's: rotation in radians, offset along
    column and row in cells, and cells a metre. The table has a border of one cell, where everything outside ends.
    A pose that is not finite gets -inf.

    Cells are found for some beams and a block of particles, in a loop that becomes a vector's, and then looked up: the
    sum waits in a register for as many beams. It is taken in the beams' order, so their number changes no bit.
    """
    rows, columns = table.shape
    cells = table.reshape(-1)
    last_column, last_row = _f(columns - 1), _f(rows - 1)
    column = np.empty(BLOCK, dtype=np.float32)
    row = np.empty(BLOCK, dtype=np.float32)
    cosine = np.empty(BLOCK, dtype=np.float32)
    sine = np.empty(BLOCK, dtype=np.float32)
    cell = np.empty((_TOGETHER, BLOCK), dtype=np.uint32)
    first, second, third, fourth = cell[0], cell[1], cell[2], cell[3]
    together = ends_x.size - ends_x.size % _TOGETHER
    total = np.empty(BLOCK, dtype=np.float32)
    frame_sine, frame_cosine = sincos(frame[0])
    scale = frame[3]
    width = np.int32(columns)
    for start in range(0, x.size, BLOCK):
        # Slices: what is indexed from zero becomes a vector.
        px, py, heading, result = x[start : start + BLOCK], y[start : start + BLOCK], theta[start:], out[start:]
        size = px.size
        for i in range(size):
            sine[i], cosine[i] = sincos(heading[i] + frame[0])
            column[i] = (frame_cosine * px[i] - frame_sine * py[i]) * scale + frame[1]
            row[i] = (frame_sine * px[i] + frame_cosine * py[i]) * scale + frame[2]
            # A place that is not a number has no cell: it is taken to the corner, and refused below.
            somewhere = abs(column[i]) + abs(row[i]) + abs(heading[i]) < _FAR
            total[i] = _ZERO if somewhere else _IMPOSSIBLE
            column[i] = column[i] if somewhere else _ZERO
            row[i] = row[i] if somewhere else _ZERO
            sine[i] = sine[i] if somewhere else _ZERO
            cosine[i] = cosine[i] if somewhere else _ZERO
        for beam in range(0, together, _TOGETHER):
            for lane in range(_TOGETHER):
                along, across = ends_x[beam + lane], ends_y[beam + lane]
                _find_cells(column, row, cosine, sine, along, across, last_column, last_row, width, size, cell[lane])
            for i in range(size):
                total[i] = (((total[i] + cells[first[i]]) + cells[second[i]]) + cells[third[i]]) + cells[fourth[i]]
        for beam in range(together, ends_x.size):
            along, across = ends_x[beam], ends_y[beam]
            _find_cells(column, row, cosine, sine, along, across, last_column, last_row, width, size, first)
            for i in range(size):
                total[i] += cells[first[i]]
        for i in range(size):
            result[i] = total[i]


@kernel
def log_of_one_more(total):
    """Replace each of ``total`` (N,) by log(1 + it), where it is not negative; -inf stays."""
    for i in range(total.size):
        more = log(_ONE + max(total[i], _ZERO))
        total[i] = _IMPOSSIBLE if total[i] == _IMPOSSIBLE else more


@device
def _find_cells(column, row, cosine, sine, along, across, last_column, last_row, width, size, cell):
    """Write to ``cell`` (N,) the number of the cell where a beam ends, for ``size`` particles."""
    for i in range(size):
        c = column[i] + cosine[i] * along - sine[i] * across
        r = row[i] + sine[i] * along + cosine[i] * across
        # Of two numbers one of which is NaN, max and min return the first.
        c = min(max(_ZERO, c), last_column)
        r = min(max(_ZERO, r), last_row)
        # Without a sign: an index that might be negative, from the end, costs a comparison at each look.
        cell[i] = np.uint32(np.int32(r) * width + np.int32(c))
