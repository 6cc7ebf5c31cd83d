"""Potentials on a grid by fast marching (Sethian: A fast marching level set method for monotonically advancing fronts,
1996), and what is asked of them: clearances before, values between the nodes after.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["interpolate", "march", "spare_clearances"]

_f = np.float32
_ZERO, _ONE = _f(0.0), _f(1.0)
_INF = _f(np.inf)
_NEVER, _DONE = np.int32(-1), np.int32(-2)  # in place of a place in the heap


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
    place = np.full(count, _NEVER, dtype=np.int32)
    heap = np.empty(count, dtype=np.int32)
    heaped = 0
    for cell in range(count):
        if flat[cell] < _INF:
            heaped = _push(heap, place, flat, heaped, np.int32(cell))
    neighbours = np.empty(6, dtype=np.int32)
    depths = np.full(values.shape, -1, dtype=np.int8)
    depth = depths.reshape(-1)
    while heaped > 0:
        cell = heap[0]
        heaped = _drop_first(heap, place, flat, heaped)
        depth[cell] = 0
        _neighbours(cell, size_x, size_y, size_t, neighbours)
        for at in range(6):
            other = neighbours[at]
            if other < 0 or place[other] == _DONE or slow[other] == _INF:
                continue
            value = _upwind(flat, other, slow[other], spacing, size_x, size_y, size_t)
            if value < flat[other]:
                flat[other] = value
                if place[other] == _NEVER:
                    heaped = _push(heap, place, flat, heaped, other)
                else:
                    _rise(heap, place, flat, place[other])
    _extend(flat, slow, depth, spacing, size_x, size_y, size_t, layers, _f(beyond))
    return depths


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
        u = min(max((x[n] - frame[0]) * frame[2], _ZERO), last_x)
        v = min(max((y[n] - frame[1]) * frame[2], _ZERO), last_y)
        w = theta[n] * frame[3]
        turned = np.floor(w)
        i, j = min(np.int32(u), np.int32(size_x - 2)), min(np.int32(v), np.int32(size_y - 2))
        p, q, r = u - _f(i), v - _f(j), w - turned
        k = np.int32(turned) % np.int32(size_t)
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
def _neighbours(cell, size_x, size_y, size_t, neighbours):
    """Write the cells before and after along each axis; -1 beyond the border and along an axis of one node."""
    plane = size_y * size_t
    i, rest = cell // plane, cell % plane
    j, k = rest // size_t, rest % size_t
    neighbours[0] = cell - plane if i > 0 else -1
    neighbours[1] = cell + plane if i < size_x - 1 else -1
    neighbours[2] = cell - size_t if j > 0 else -1
    neighbours[3] = cell + size_t if j < size_y - 1 else -1
    neighbours[4] = -1 if size_t == 1 else (cell - 1 if k > 0 else cell + size_t - 1)
    neighbours[5] = -1 if size_t == 1 else (cell + 1 if k < size_t - 1 else cell - size_t + 1)


@device
def _lower(flat, first, second):
    a = flat[first] if first >= 0 else _INF
    b = flat[second] if second >= 0 else _INF
    return min(a, b)


@device
def _upwind(flat, cell, slow, spacing, size_x, size_y, size_t):
    """Return the V with sum over axes of ((V - a)+ / h)^2 = slowness^2, where a is the axis' lower neighbour."""
    plane = size_y * size_t
    i, rest = cell // plane, cell % plane
    j, k = rest // size_t, rest % size_t
    a = _lower(flat, cell - plane if i > 0 else -1, cell + plane if i < size_x - 1 else -1)
    b = _lower(flat, cell - size_t if j > 0 else -1, cell + size_t if j < size_y - 1 else -1)
    c = _INF
    if size_t > 1:
        c = _lower(flat, cell - 1 if k > 0 else cell + size_t - 1, cell + 1 if k < size_t - 1 else cell - size_t + 1)
    ha, hb, hc = spacing[0], spacing[1], spacing[2]
    if a > b:
        a, b, ha, hb = b, a, hb, ha
    if b > c:
        b, c, hb, hc = c, b, hc, hb
    if a > b:
        a, b, ha, hb = b, a, hb, ha
    # In differences to the lowest neighbour, so that little is lost in float32.
    rise = slow * ha
    if a + rise <= b:
        return a + rise
    wa, wb, db = _ONE / (ha * ha), _ONE / (hb * hb), b - a
    square = slow * slow
    total, mixed, rest_of = wa + wb, wb * db, wb * db * db - square
    rise = (mixed + np.sqrt(max(mixed * mixed - total * rest_of, _ZERO))) / total
    if a + rise <= c:
        return a + rise
    wc, dc = _ONE / (hc * hc), c - a
    total, mixed, rest_of = total + wc, mixed + wc * dc, rest_of + wc * dc * dc
    return a + (mixed + np.sqrt(max(mixed * mixed - total * rest_of, _ZERO))) / total


@device
def _extend(flat, slow, depth, spacing, size_x, size_y, size_t, layers, beyond):
    neighbours = np.empty(6, dtype=np.int32)
    for layer in range(1, layers + 1):
        for cell in range(flat.size):
            if depth[cell] >= 0 or slow[cell] < _INF:
                continue
            _neighbours(np.int32(cell), size_x, size_y, size_t, neighbours)
            best = _INF
            for at in range(6):
                other = neighbours[at]
                if other >= 0 and depth[other] == layer - 1:
                    best = min(best, flat[other] + beyond * spacing[at // 2])
            if best < _INF:
                flat[cell] = best
                depth[cell] = layer


@device
def _push(heap, place, flat, heaped, cell):
    heap[heaped] = cell
    place[cell] = heaped
    _rise(heap, place, flat, heaped)
    return heaped + 1


@device
def _rise(heap, place, flat, at):
    cell = heap[at]
    value = flat[cell]
    while at > 0:
        parent = (at - 1) >> 1
        above = heap[parent]
        if flat[above] <= value:
            break
        heap[at] = above
        place[above] = at
        at = parent
    heap[at] = cell
    place[cell] = at


@device
def _drop_first(heap, place, flat, heaped):
    place[heap[0]] = _DONE
    heaped -= 1
    if heaped == 0:
        return heaped
    cell = heap[heaped]
    value = flat[cell]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= heaped:
            break
        if child + 1 < heaped and flat[heap[child + 1]] < flat[heap[child]]:
            child += 1
        if flat[heap[child]] >= value:
            break
        heap[at] = heap[child]
        place[heap[at]] = at
        at = child
    heap[at] = cell
    place[cell] = at
    return heaped
