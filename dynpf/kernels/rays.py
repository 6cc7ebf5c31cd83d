"""Exact rays through a grid: leaps over cones that are known to be free, many rays in step.

A ray is turned, by reflections and a transposition of the grid, into one that goes from column to column and climbs by
a slope between 0 and 1: one of eight tables holds the grid so turned. There, whatever a ray does after it entered a
cell, within k columns it stays in a cone of cells, j + 2 of them in column j. The table says for each cell how many
columns of its cone are free, so a ray may leap over them: never past a wall, and usually far. What is left is exact
traversal, column by column, of at most two cells each (Amanatides and Woo, 1987, visit the same cells).

A leap waits for one byte of memory, so many rays advance in step: first all read, then all leap. The first leaps are
made by all of them, so that the loops become vectors; the rays that are still under way then go on in a loop without
branches. Every ray is computed by itself: the result does not depend on its neighbours.
"""

import numpy as np

from dynpf.kernels.compiler import kernel
from dynpf.kernels.elementary import sincos

__all__ = ["FIELDS", "LANES", "cast", "fill_cones", "trace"]

LANES = 512
"""Rays in step: what they need fills half of the fastest cache."""
FIELDS = 7
"""Numbers kept for a ray, of each kind."""
TOGETHER = 5
"""Leaps made by all rays, at rest or not: few need more."""

_f, _i, _u = np.float32, np.int32, np.uint64
_ZERO, _ONE, _FAR, _TINY = _f(0.0), _f(1.0), _f(1e9), _f(1e-12)
_NONE, _ROWS_REVERSED, _COLUMNS_REVERSED, _TRANSPOSED = _i(0), _i(1), _i(2), _i(4)

# A table's values: a wall, the number of free columns of the cone, or a free cell with a wall in the row above.
_WALL, _FARTHEST, _WALL_ABOVE = _i(0), _i(127), _i(128 + 1)

# Where the fields of the rays lie in two arrays, so that the loop over rays keeps few addresses.
_INTERCEPT, _SLOPE, _START_COLUMN, _START_ROW, _PER_COLUMN, _PER_ROW, _ENTRY = range(FIELDS)
_CELL, _STRIDE, _END, _COLUMN, _ROW, _ALIVE, _NEXT = range(FIELDS)
_TO_SLOPE, _TO_STRIDE, _TO_END = _u(_SLOPE * LANES), _u(_STRIDE * LANES), _u(_END * LANES)
_TO_COLUMN, _TO_ROW, _TO_ALIVE, _TO_NEXT = _u(_COLUMN * LANES), _u(_ROW * LANES), _u(_ALIVE * LANES), _u(_NEXT * LANES)


@kernel
def fill_cones(occupied, table):
    """Fill ``table`` ((H + 2) * W,) with the cones of a grid (H, W), uint8, one where a ray is stopped.

    Beyond the grid all is free. Two rows above it may be read, too, since a ray leaves it by rounding.
    """
    rows, columns = occupied.shape
    table[rows * columns :] = _FARTHEST
    for row in range(rows - 1, -1, -1):
        ahead, ahead_above = _FARTHEST, _FARTHEST
        for column in range(columns - 1, -1, -1):
            cell = row * columns + column
            above = _i(table[cell + columns])
            free = min(_FARTHEST, _i(1) + min(ahead, ahead_above))
            free = _WALL_ABOVE if above == _WALL else free
            free = _WALL if occupied[row, column] != 0 else free
            table[cell] = free
            ahead = _NONE if free == _WALL_ABOVE else free
            ahead_above = _NONE if above == _WALL_ABOVE else above


@kernel
def _aim(
    column,
    row,
    direction,
    count,
    size,
    reach,
    table_size,
    intercept,
    slope,
    start_column,
    start_row,
    per_column,
    per_row,
    entry,
    cell,
    stride,
    end,
):
    """Turn rays into climbing ones, enter the grid with them, and say where each has left it or its reach."""
    width, height = _f(size[0]), _f(size[1])
    for i in range(count):
        along_y, along_x = sincos(direction[i])
        steep = abs(along_y) > abs(along_x)
        x = row[i] if steep else column[i]
        y = column[i] if steep else row[i]
        dx = along_y if steep else along_x
        dy = along_x if steep else along_y
        columns = height if steep else width
        rows = width if steep else height
        table = _TRANSPOSED if steep else _NONE
        table = table + (_COLUMNS_REVERSED if dx < _ZERO else _NONE) + (_ROWS_REVERSED if dy < _ZERO else _NONE)
        x = columns - x if dx < _ZERO else x
        y = rows - y if dy < _ZERO else y
        dx = abs(dx)
        dy = max(abs(dy), _TINY)
        climb = dy / dx
        column_length, row_length = _ONE / dx, _ONE / dy
        enter = max(x, _ZERO)
        enter = max(enter, x - y * (dx * row_length)) if y < _ZERO else enter
        enter_row = max(y + climb * (enter - x), _ZERO)
        # False, too, where a number is none.
        meets = (abs(x) + abs(y) < _FAR) & (climb <= _FAR) & (enter < columns) & (enter_row < rows)
        first_column = np.floor(enter) if meets else _ZERO
        first_row = np.floor(enter_row) if meets else _ZERO
        x = x - first_column
        y = y - first_row
        # A ray that does not meet the grid stays in its corner, whatever its numbers are.
        climb = climb if meets else _ZERO
        at_left = min(max(y - climb * x, -_ONE), _ONE) if meets else _ZERO
        through_top = (rows - first_row - at_left) * (dx * row_length) + _ONE
        last = min(columns - first_column, through_top, reach * dx + x + _ONE)
        last = max(last, _ZERO) if meets else _ZERO
        intercept[i] = at_left
        slope[i] = climb
        start_column[i] = x
        start_row[i] = y
        per_column[i] = column_length
        per_row[i] = row_length
        entry[i] = (enter - first_column - x) * column_length
        cell[i] = table * _i(table_size) + _i(first_row) * _i(columns) + _i(first_column)
        stride[i] = _i(columns)
        end[i] = _i(last)


@kernel
def _leap(count, nowhere, intercept, slope, cell, stride, end, values, column, row, following):
    """Leap once with all rays, given the values where they stand, and say which cell each stands in then.

    That is ``nowhere``, a wall, for a ray that has come to rest: it does not move any more. One that is stopped keeps
    the column and row of the cell that stopped it; one that is not has reached its end.
    """
    for i in range(count):
        value = _i(values[i])
        old_column, old_row = column[i], row[i]
        new_column = _i(old_column + _i(value & _FARTHEST))
        # Truncation keeps the first row for a ray that starts in the middle of its column, below it at the left.
        new_row = max(_i(intercept[i] + slope[i] * _f(new_column)), old_row)
        from_below = (value > _FARTHEST) & (new_row != old_row)
        runs = (value != _WALL) & (not from_below) & (new_column < end[i])
        following[i] = _i(_i(cell[i] + new_column) + _i(new_row * stride[i])) if runs else nowhere
        column[i] = old_column if from_below else new_column
        row[i] = new_row


@kernel
def _finish(tables, count, nowhere, reals, integers, values):
    """Leap on with the rays that have not come to rest, as ``_leap`` does, until all have."""
    alive = _u(0)
    for k in range(count):
        following = integers[_u(k) + _TO_NEXT]
        integers[alive + _TO_ALIVE] = _i(k)
        integers[alive + _TO_NEXT] = following
        alive += _u(following != nowhere)
    while alive > _u(0):
        for k in range(alive):
            values[_u(k)] = tables[_u(np.uint32(integers[_u(k) + _TO_NEXT]))]
        kept = _u(0)
        for k in range(alive):
            i = _u(np.uint32(integers[_u(k) + _TO_ALIVE]))
            value = _i(values[_u(k)])
            column, row = integers[i + _TO_COLUMN], integers[i + _TO_ROW]
            new_column = column + (value & _FARTHEST)
            new_row = max(_i(reals[i] + reals[i + _TO_SLOPE] * _f(new_column)), row)
            runs = new_column < integers[i + _TO_END]
            integers[kept + _TO_NEXT] = integers[i] + new_column + new_row * integers[i + _TO_STRIDE]
            new_column = column if (value > _FARTHEST) & (new_row != row) else new_column
            integers[i + _TO_COLUMN] = new_column
            integers[i + _TO_ROW] = new_row
            integers[kept + _TO_ALIVE] = _i(i)
            kept += _u(_i(runs) & _i(new_column != column))
        alive = kept


@kernel
def _measure(count, reach, start_column, start_row, per_column, per_row, entry, column, row, end, out):
    """Write where the rays meet the cells that stopped them: they enter the later of their column and their row."""
    for i in range(count):
        from_left = max((_f(column[i]) - start_column[i]) * per_column[i], entry[i])
        from_below = (_f(row[i]) - start_row[i]) * per_row[i]
        distance = min(max(from_left, from_below), reach)
        out[i] = distance if column[i] < end[i] else reach


@kernel
def trace(column, row, direction, count, tables, size, reach, reals, integers, values, out):
    """Write to ``out`` the lengths of ``count`` rays, at most LANES, in cells: ``reach`` where nothing stops them.

    Origins are in cells, directions in radians, both in the grid's frame. ``tables`` (8, more than (H + 2) * W): the
    cones of the grid turned each way, the last byte of all zero. ``size``: W and H. The rest is room: ``reals`` and
    ``integers`` (FIELDS, LANES), ``values`` (LANES,), float32, int32 and uint8.
    """
    _aim(
        column,
        row,
        direction,
        count,
        size,
        reach,
        tables.shape[1],
        reals[_INTERCEPT],
        reals[_SLOPE],
        reals[_START_COLUMN],
        reals[_START_ROW],
        reals[_PER_COLUMN],
        reals[_PER_ROW],
        reals[_ENTRY],
        integers[_CELL],
        integers[_STRIDE],
        integers[_END],
    )
    cells, following = tables.reshape(-1), integers[_NEXT]
    nowhere = _i(cells.size - 1)
    for i in range(count):
        integers[_COLUMN, i] = _NONE
        integers[_ROW, i] = _NONE
        following[i] = integers[_CELL, i] if integers[_END, i] > _NONE else nowhere
    for _ in range(TOGETHER):
        for i in range(count):
            values[_u(i)] = cells[_u(np.uint32(following[_u(i)]))]
        _leap(
            count,
            nowhere,
            reals[_INTERCEPT],
            reals[_SLOPE],
            integers[_CELL],
            integers[_STRIDE],
            integers[_END],
            values,
            integers[_COLUMN],
            integers[_ROW],
            following,
        )
    _finish(cells, count, nowhere, reals.reshape(-1), integers.reshape(-1), values)
    _measure(
        count,
        reach,
        reals[_START_COLUMN],
        reals[_START_ROW],
        reals[_PER_COLUMN],
        reals[_PER_ROW],
        reals[_ENTRY],
        integers[_COLUMN],
        integers[_ROW],
        integers[_END],
        out,
    )


@kernel
def cast(x, y, angles, tables, size, frame, range_max, out):
    """Write to ``out`` (N,) the lengths of rays in metres, from (x, y) along ``angles``, in the map's frame.

    ``frame`` (4,) takes that into the grid's: rotation in radians, offset along column and row in cells, and cells a
    metre. ``range_max`` where nothing stops a ray.
    """
    column = np.empty(LANES, dtype=np.float32)
    row = np.empty(LANES, dtype=np.float32)
    direction = np.empty(LANES, dtype=np.float32)
    length = np.empty(LANES, dtype=np.float32)
    reals = np.empty((FIELDS, LANES), dtype=np.float32)
    integers = np.empty((FIELDS, LANES), dtype=np.int32)
    values = np.empty(LANES, dtype=np.uint8)
    turn, offset_column, offset_row, scale = frame[0], frame[1], frame[2], frame[3]
    sine, cosine = sincos(turn)
    longest = _f(range_max)
    reach = longest * scale
    metres = _ONE / scale
    for start in range(0, x.size, LANES):
        count = min(LANES, x.size - start)
        from_x, from_y, along, far = x[start:], y[start:], angles[start:], out[start:]
        for i in range(count):
            column[i] = (cosine * from_x[i] - sine * from_y[i]) * scale + offset_column
            row[i] = (sine * from_x[i] + cosine * from_y[i]) * scale + offset_row
            direction[i] = along[i] + turn
        trace(column, row, direction, count, tables, size, reach, reals, integers, values, length)
        for i in range(count):
            far[i] = length[i] * metres if length[i] < reach else longest
