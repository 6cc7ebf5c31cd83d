"""Potentials on a grid by a marching front, and what is asked of them: clearances before, values between nodes after.

The front advances in bands, within which nodes are corrected until nothing changes (Kim: An O(N) level set method for
eikonal equations, 2001; Jeong and Whitaker: A fast iterative method for eikonal equations, 2008). That solves the same
upwind equations as fast marching (Sethian 1996) without keeping the front in order.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import whole

__all__ = ["interpolate", "march", "spare_clearances"]

_f = np.float32
_ZERO, _ONE = _f(0.0), _f(1.0)
_INF = _f(np.inf)


@kernel
def spare_clearances(x, y, radius, centre_x, centre_y, kept, half_x, half_y, out):
    """Lower ``out`` (N,) to what is left at (x, y) (N,) for a disc of ``radius`` before obstacles and walls begin.

    ``kept`` (n,) are the obstacles' radii and the clearance to be kept from them; the walls are at +-half_x, +-half_y.
    """
    radius, half_x, half_y = _f(radius), _f(half_x), _f(half_y)
    for i in range(x.size):
        out[i] = min(out[i], min(half_x - abs(x[i]), half_y - abs(y[i])) - radius)
    for j in range(kept.size):
        other_x, other_y, contact = centre_x[j], centre_y[j], kept[j] + radius
        for i in range(x.size):
            dx, dy = x[i] - other_x, y[i] - other_y
            out[i] = min(out[i], np.sqrt(dx * dx + dy * dy) - contact)


@kernel
def march(values, slowness, spacing, layers, beyond):
    """Solve |grad V| = slowness upwind over (X, Y, T), T periodic, from the finite ``values``; return the depths.

    Where the slowness is infinite the way is closed. ``values`` is completed in place. Closed nodes beside the solution
    get values too, ``layers`` deep and rising by ``beyond`` a metre, so that a way out leads back; depths, int8, are 0
    where the front came, the layer in that fringe, -1 elsewhere, where values stay infinite.
    """
    size_x, size_y, size_t = values.shape
    flat, slow = values.reshape(-1), slowness.reshape(-1)
    count = flat.size
    # Two queues of the nodes from which V may still fall elsewhere: within the present band, and beyond it.
    queue, later = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    queued = np.zeros(count, dtype=np.bool_)
    lowest, put_off = _INF, 0
    for cell in range(count):
        if flat[cell] < _INF:
            later[put_off], queued[cell] = cell, True
            put_off += 1
            lowest = min(lowest, flat[cell])
    band = min(spacing[0], spacing[1])
    weights = _ONE / (spacing * spacing)
    while put_off > 0:
        queue, later = later, queue
        head, tail, waiting = 0, put_off % count, put_off
        top, lowest, put_off = lowest + band, _INF, 0
        while waiting > 0:
            cell = queue[head]
            head = head + 1 if head + 1 < count else 0
            waiting -= 1
            value = flat[cell]
            if value > top:
                later[put_off] = cell
                put_off += 1
                lowest = min(lowest, value)
                continue
            queued[cell] = False
            i, j, k = _place(cell, size_y, size_t)
            for at in range(6 if size_t > 1 else 4):
                other, p, q, r = _neighbour(at, cell, i, j, k, size_x, size_y, size_t)
                if other < 0 or flat[other] <= value or slow[other] == _INF:
                    continue
                lowered = _upwind(flat, other, p, q, r, slow[other], spacing, weights, size_x, size_y, size_t)
                if lowered < flat[other]:
                    flat[other] = lowered
                    if not queued[other]:
                        queued[other] = True
                        queue[tail] = other
                        tail = tail + 1 if tail + 1 < count else 0
                        waiting += 1
    return _extended(flat, slow, spacing, size_x, size_y, size_t, layers, _f(beyond)).reshape(values.shape)


@kernel
def interpolate(ratios, frame, x, y, theta, out):
    """Write to ``out`` (N,) the potential at (x, y, theta) (N,): the distance to go times the ratio between nodes.

    ``ratios`` (X, Y, T): potential / distance at the nodes, infinite where there is none, and such nodes are left out.
    ``frame`` (7,): x and y of node (0, 0), nodes a metre, nodes a radian, the goal's x and y, and the length that
    rounds off the distance's tip. Linear along each axis.
    """
    size_x, size_y, size_t = ratios.shape
    last_x, last_y, tip = _f(size_x - 1), _f(size_y - 1), frame[6] * frame[6]
    for n in range(x.size):
        # Of two numbers one of which is NaN, max and min return the first.
        u = min(max(_ZERO, (x[n] - frame[0]) * frame[2]), last_x)
        v = min(max(_ZERO, (y[n] - frame[1]) * frame[2]), last_y)
        w = theta[n] * frame[3]
        turned = np.floor(w)
        i, j = min(np.int32(u), np.int32(size_x - 2)), min(np.int32(v), np.int32(size_y - 2))
        p, q, r = u - _f(i), v - _f(j), w - turned
        k = whole(turned) % np.int32(size_t)
        after = (k + np.int32(1)) % np.int32(size_t)
        total, weights = _ZERO, _ZERO
        for corner in range(8):
            a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
            weight = (p if a else _ONE - p) * (q if b else _ONE - q) * (r if c else _ONE - r)
            ratio = ratios[i + a, j + b, after if c else k]
            if weight > _ZERO and ratio < _INF:
                total += weight * ratio
                weights += weight
        dx, dy = x[n] - frame[4], y[n] - frame[5]
        out[n] = np.sqrt(dx * dx + dy * dy + tip) * (total / weights) if weights > _ZERO else _INF


@device
def _place(cell, size_y, size_t):
    plane, size = np.int32(size_y * size_t), np.int32(size_t)
    i = cell // plane
    rest = cell - i * plane
    j = rest // size
    return i, j, rest - j * size


@device
def _neighbour(at, cell, i, j, k, size_x, size_y, size_t):
    """Return the cell before (``at`` 0, 2, 4) or after (1, 3, 5) along an axis, and its place; -1 beyond the border."""
    plane = size_y * size_t
    if at == 0:
        return (cell - plane if i > 0 else -1), i - 1, j, k
    if at == 1:
        return (cell + plane if i < size_x - 1 else -1), i + 1, j, k
    if at == 2:
        return (cell - size_t if j > 0 else -1), i, j - 1, k
    if at == 3:
        return (cell + size_t if j < size_y - 1 else -1), i, j + 1, k
    if at == 4:
        return (cell - 1, i, j, k - 1) if k > 0 else (cell + size_t - 1, i, j, size_t - 1)
    return (cell + 1, i, j, k + 1) if k < size_t - 1 else (cell - size_t + 1, i, j, 0)


@device
def _upwind(flat, cell, i, j, k, slow, spacing, weights, size_x, size_y, size_t):
    """Return the V with sum over axes of ((V - a)+ / h)^2 = slowness^2, where a is the axis' lower neighbour."""
    plane = size_y * size_t
    a = min(flat[cell - plane] if i > 0 else _INF, flat[cell + plane] if i < size_x - 1 else _INF)
    b = min(flat[cell - size_t] if j > 0 else _INF, flat[cell + size_t] if j < size_y - 1 else _INF)
    c = _INF
    if size_t > 1:
        c = min(flat[cell - 1 if k > 0 else cell + size_t - 1], flat[cell + 1 if k < size_t - 1 else cell - size_t + 1])
    ha, hb, hc = spacing[0], spacing[1], spacing[2]
    wa, wb, wc = weights[0], weights[1], weights[2]
    if a > b:
        a, b, ha, hb, wa, wb = b, a, hb, ha, wb, wa
    if b > c:
        b, c, hb, hc, wb, wc = c, b, hc, hb, wc, wb
    if a > b:
        a, b, ha, hb, wa, wb = b, a, hb, ha, wb, wa
    # In differences to the lowest neighbour, so that little is lost in float32.
    rise = slow * ha
    if a + rise <= b:
        return a + rise
    db = b - a
    total, mixed, rest_of = wa + wb, wb * db, wb * db * db - slow * slow
    rise = (mixed + np.sqrt(max(mixed * mixed - total * rest_of, _ZERO))) / total
    if a + rise <= c:
        return a + rise
    dc = c - a
    total, mixed, rest_of = total + wc, mixed + wc * dc, rest_of + wc * dc * dc
    return a + (mixed + np.sqrt(max(mixed * mixed - total * rest_of, _ZERO))) / total


@device
def _extended(flat, slow, spacing, size_x, size_y, size_t, layers, beyond):
    """Return the depths of all cells, and give values to those of the fringe."""
    depth = np.empty(flat.size, dtype=np.int8)
    for cell in range(flat.size):
        depth[cell] = 0 if flat[cell] < _INF else -1
    for layer in range(1, layers + 1):
        for cell in range(flat.size):
            if depth[cell] >= 0 or slow[cell] < _INF:
                continue
            i, j, k = _place(np.int32(cell), size_y, size_t)
            best = _INF
            for at in range(6 if size_t > 1 else 4):
                other, _, _, _ = _neighbour(at, cell, i, j, k, size_x, size_y, size_t)
                if other >= 0 and depth[other] == layer - 1:
                    best = min(best, flat[other] + beyond * spacing[at // 2])
            if best < _INF:
                flat[cell] = best
                depth[cell] = layer
    return depth
