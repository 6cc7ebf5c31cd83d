"""The beam model: what a reading is worth for each length of its ray, and the sum over beams."""

import numpy as np

from dynpf.kernels.compiler import kernel
from dynpf.kernels.elementary import exp, log, sincos
from dynpf.kernels.rays import FIELDS, LANES, trace

__all__ = ["fill_log_densities", "log_mixture", "sum_over_beams"]

_f, _i, _u = np.float32, np.int32, np.uint64
_ZERO, _ONE, _MINUS_HALF, _IMPOSSIBLE = _f(0.0), _f(1.0), _f(-0.5), _f(-np.inf)


@kernel
def fill_log_densities(ranges, lengths, hit, short, rest, scales, out):
    """Write to ``out`` (B, K) the log density of each reading (B,) where the ray has one of the ``lengths`` (K,).

    ``hit`` and ``short`` (K,): what those two parts of the mixture are at their peaks; ``rest`` (B,): the sum of the
    others. ``scales`` (2,): sigma_hit and lambda_short. No less than log 1.2e-38 = -87.3.
    """
    per_sigma, decay = _ONE / scales[0], scales[1]
    for b in range(ranges.size):
        reading, others = ranges[b], rest[b]
        early = exp(-decay * reading)
        row = out[b]
        for k in range(lengths.size):
            error = (reading - lengths[k]) * per_sigma
            density = hit[k] * exp(_MINUS_HALF * error * error) + others
            density += short[k] * early if reading <= lengths[k] else _ZERO
            row[k] = log(density)


@kernel
def log_mixture(deviations, share, uniform, out):
    """Write the logarithm of (1 - share) exp(-d^2 / 2) + share uniform to ``out``, of deviations d (N,) float32."""
    hit, rest = _ONE - _f(share), _f(share) * _f(uniform)
    for i in range(deviations.size):
        out[i] = log(hit * exp(_MINUS_HALF * (deviations[i] * deviations[i])) + rest)


@kernel
def sum_over_beams(x, y, theta, table, tables, size, frame, out):
    """Write to ``out`` (N,) the sum over beams of the log density of each at the length of its ray.

    ``table``: a ``dynpf.measurement.beam.BeamTable``, linear between its lengths. ``tables``, ``size`` and ``frame``:
    see ``rays.cast``. -inf for a robot in a wall or off the grid.
    """
    angles, log_densities, sensor = table.angles, table.log_densities, table.sensor
    beams, nodes = log_densities.shape
    column = np.empty(LANES, dtype=np.float32)
    row = np.empty(LANES, dtype=np.float32)
    heading = np.empty(LANES, dtype=np.float32)
    direction = np.empty(LANES, dtype=np.float32)
    length = np.empty(LANES, dtype=np.float32)
    total = np.empty(LANES, dtype=np.float32)
    reals = np.empty((FIELDS, LANES), dtype=np.float32)
    integers = np.empty((FIELDS, LANES), dtype=np.int32)
    values = np.empty(LANES, dtype=np.uint8)
    turn, offset_column, offset_row, scale = frame[0], frame[1], frame[2], frame[3]
    along, across = sensor[0], sensor[1]
    sine, cosine = sincos(turn)
    width, height = _f(size[0]), _f(size[1])
    reach = _f(table.range_max) * scale
    per_cell = _f(table.per_length) / scale
    last = _f(nodes - 2)
    grid = tables[0]
    for start in range(0, x.size, LANES):
        count = min(LANES, x.size - start)
        from_x, from_y, from_theta, summed = x[start:], y[start:], theta[start:], out[start:]
        for i in range(count):
            c = (cosine * from_x[i] - sine * from_y[i]) * scale + offset_column
            r = (sine * from_x[i] + cosine * from_y[i]) * scale + offset_row
            heading[i] = from_theta[i] + turn
            s_heading, c_heading = sincos(heading[i])
            column[i] = c + c_heading * along - s_heading * across
            row[i] = r + s_heading * along + c_heading * across
            inside = (c >= _ZERO) & (c < width) & (r >= _ZERO) & (r < height) & (abs(heading[i]) < _f(np.inf))
            cell = _i(r if inside else _ZERO) * _i(width) + _i(c if inside else _ZERO)
            total[i] = _ZERO if inside & (grid[_u(cell)] != 0) else _IMPOSSIBLE
        for b in range(beams):
            angle, densities = angles[b], log_densities[b]
            for i in range(count):
                direction[i] = heading[i] + angle
            trace(column, row, direction, count, tables, size, reach, reals, integers, values, length)
            for i in range(count):
                position = length[i] * per_cell
                node = min(np.floor(position), last)
                before = densities[_u(_i(node))]
                after = densities[_u(_i(node)) + _u(1)]
                total[i] += before + (position - node) * (after - before)
        for i in range(count):
            summed[i] = total[i]
