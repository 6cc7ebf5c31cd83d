"""Poses counted in cells of x, y and heading: how many cells are occupied, and which of them touch.

Cells are looked up by open addressing in a table twice as long as there are particles. Positions more than 2**22 cells
from the origin count as that far; poses that are not finite are in no cell.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["clusters", "occupied"]

_BLOCK = 256
_f, _d, _i, _u = np.float32, np.float64, np.int64, np.uint64
_FAR, _ZERO, _TURNS = _f(2.0**22), _f(0.0), _f(0.5 / np.pi)
_CENTRE, _MASK_24, _MASK_16 = _i(2**23), _i(2**24 - 1), _i(2**16 - 1)
_EMPTY = _i(-1)
# 2**64 over the golden ratio spreads neighbouring keys (Knuth, vol. 3, section 6.4).
_GOLDEN = _u(0x9E3779B97F4A7C15)


@device
def _fill_keys(x, y, theta, per_x, per_y, turn_bins, keys):
    """Write the key of each pose's cell, (n,) int64: 24 bits each for column and row, 16 for the heading."""
    for j in range(x.size):
        # Zero unless something is infinite or not a number.
        finite = (x[j] - x[j]) + (y[j] - y[j]) + (theta[j] - theta[j]) == _ZERO
        column = np.floor((x[j] if finite else _ZERO) * per_x)
        row = np.floor((y[j] if finite else _ZERO) * per_y)
        turn = (theta[j] if finite else _ZERO) * _TURNS
        turn = (turn - np.floor(turn)) * turn_bins
        column, row = min(max(column, -_FAR), _FAR), min(max(row, -_FAR), _FAR)
        # A heading just below zero is rounded to a whole turn.
        key = _key(_i(np.int32(column)), _i(np.int32(row)), _i(np.int32(min(turn, turn_bins - _f(1.0)))))
        keys[j] = key if finite else _EMPTY


@device
def _key(column, row, turn):
    return ((column + _CENTRE) << _i(40)) | ((row + _CENTRE) << _i(16)) | turn


@device
def _slot(table, shift, key):
    """Return where in the table the key is, or the free place where it belongs."""
    slot = _i((_u(key) * _GOLDEN) >> shift)
    while table[slot] != key and table[slot] != _EMPTY:
        slot = (slot + 1) & (table.size - 1)
    return slot


@device
def _table_bits(count):
    bits = 4
    while (1 << bits) < 2 * count:
        bits += 1
    return bits


@kernel
def occupied(x, y, theta, weights, per_x, per_y, turn_bins):
    """Return how many cells hold a survivor of a comb of N teeth, half a tooth in, through the weights (N,).

    A weight that is negative or not a number counts as zero; without a finite sum above zero there are no survivors.
    Coordinates and weights are float32; ``per_x`` and ``per_y`` are cells a metre, ``turn_bins`` < 2**16 cells a turn.
    """
    count = x.size
    bits = _table_bits(count)
    shift = _u(64 - bits)
    table = np.full(1 << bits, _EMPTY)
    keys = np.empty(_BLOCK, dtype=np.int64)
    total = _d(0.0)
    for i in range(count):
        total += _d(weights[i] if weights[i] > _ZERO else _ZERO)
    per_weight = _d(count) / total
    cumulative, tooth, cells = _d(0.0), _d(0.0), 0
    for start in range(0, count, _BLOCK):
        end = min(start + _BLOCK, count)
        _fill_keys(x[start:end], y[start:end], theta[start:end], _f(per_x), _f(per_y), _f(turn_bins), keys)
        weight = weights[start:end]
        for j in range(end - start):
            cumulative += _d(weight[j] if weight[j] > _ZERO else _ZERO)
            after = np.ceil(cumulative * per_weight - _d(0.5))
            if after > tooth and keys[j] != _EMPTY:
                slot = _slot(table, shift, keys[j])
                cells += table[slot] == _EMPTY
                table[slot] = keys[j]
            tooth = after
    return cells


@kernel
def clusters(x, y, theta, weights, per_m, turn_bins, sparse, labels, masses):
    """Write to ``labels`` (N,) int32 each particle's cluster, -1 for none, and to ``masses`` (N,) theirs.

    A cluster is a set of cells that touch; it is named by its first cell, and cells by when a particle first met them.
    Cells lighter than ``sparse`` times the heaviest belong to none. ``masses`` are to come in as zeros; returns the
    weight of all particles that are in a cell.
    """
    count = x.size
    bits = _table_bits(count)
    shift = _u(64 - bits)
    table, numbers = np.full(1 << bits, _EMPTY), np.empty(1 << bits, dtype=np.int32)
    keys, found, cell_masses = np.empty(_BLOCK, dtype=np.int64), np.empty(count, dtype=np.int64), np.zeros(count)
    cells = 0
    for start in range(0, count, _BLOCK):
        end = min(start + _BLOCK, count)
        _fill_keys(x[start:end], y[start:end], theta[start:end], _f(per_m), _f(per_m), _f(turn_bins), keys)
        for j in range(end - start):
            labels[start + j] = -1
            weight = weights[start + j]
            if keys[j] != _EMPTY and weight > _ZERO:
                slot = _slot(table, shift, keys[j])
                if table[slot] == _EMPTY:
                    table[slot], numbers[slot], found[cells] = keys[j], cells, keys[j]
                    cells += 1
                labels[start + j] = numbers[slot]
                cell_masses[numbers[slot]] += _d(weight)

    total, heaviest = _d(0.0), _d(0.0)
    for cell in range(cells):
        total += cell_masses[cell]
        heaviest = max(heaviest, cell_masses[cell])
    parents = np.arange(cells)
    for cell in range(cells):
        if cell_masses[cell] < sparse * heaviest:
            parents[cell] = -1
    _join_neighbours(found[:cells], turn_bins, table, shift, numbers, parents)
    for cell in range(cells):
        if parents[cell] >= 0:
            masses[parents[cell]] += cell_masses[cell]
    for i in range(count):
        if labels[i] >= 0:
            labels[i] = parents[labels[i]]
    return total


@device
def _join_neighbours(found, turn_bins, table, shift, numbers, parents):
    """Give each cell (C,) that has a parent the first cell of its cluster for one.

    Half of the 26 neighbours are enough: the other half meet the cell when it is their turn.
    """
    for cell in range(found.size):
        if parents[cell] < 0:
            continue
        key = found[cell]
        column, row, turn = (key >> _i(40)) - _CENTRE, ((key >> _i(16)) & _MASK_24) - _CENTRE, key & _MASK_16
        for step in range(14, 27):
            beside = (turn + step % 3 - 1 + turn_bins) % turn_bins
            slot = _slot(table, shift, _key(column + step // 9 - 1, row + step // 3 % 3 - 1, beside))
            if table[slot] != _EMPTY and parents[numbers[slot]] >= 0:
                this, other = _root(parents, cell), _root(parents, _i(numbers[slot]))
                parents[max(this, other)] = min(this, other)
    for cell in range(found.size):
        if parents[cell] >= 0:
            # A parent comes before its cell, and so has been led to the root already.
            parents[cell] = parents[parents[cell]]


@device
def _root(parents, cell):
    while parents[cell] != cell:
        parents[cell] = parents[parents[cell]]
        cell = parents[cell]
    return cell
