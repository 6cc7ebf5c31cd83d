"""The cheapest assignment of rows to columns: which of several goals, or of several measurements, is whose."""

import math

import numpy as np
from numpy.typing import NDArray

from dynpf.types import FloatArray

__all__ = ["assign", "cheapest_exchanges"]


def assign(costs: FloatArray) -> NDArray[np.intp]:
    """Return a column for each row, no column twice, with the least sum of costs.

    ``costs`` has shape (n, m) with n <= m, infinite where a pair is impossible. By shortest augmenting paths (Kuhn and
    Munkres, in the form of Jonker and Volgenant 1987), O(n^2 m); of assignments with the same sum it is always the
    same one. Raises ValueError where there is no assignment.
    """
    rows, columns = costs.shape
    # Index 0 is a column of its own, from which the path of each row begins; rows count from 1, and 0 is none.
    row_prices, column_prices = np.zeros(rows + 1), np.zeros(columns + 1)
    owner = np.zeros(columns + 1, dtype=np.intp)
    for row in range(1, rows + 1):
        owner[0], column = row, 0
        distance, before = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=np.intp)
        reached = np.zeros(columns + 1, dtype=bool)
        while column == 0 or owner[column]:
            reached[column] = True
            reduced = np.append(np.inf, costs[owner[column] - 1] - row_prices[owner[column]] - column_prices[1:])
            shorter = ~reached & (reduced < distance)
            distance, before = np.where(shorter, reduced, distance), np.where(shorter, column, before)
            open_distance = np.where(reached, np.inf, distance)
            column = int(open_distance.argmin())
            step = float(open_distance[column])
            if not math.isfinite(step):
                raise ValueError(f"no assignment of {rows} rows to {columns} columns: too many pairs are impossible")
            row_prices[owner[reached]] += step
            column_prices[reached] -= step
            distance = np.where(reached, distance, distance - step)
        while column:
            owner[column] = owner[before[column]]
            column = int(before[column])
    return np.argsort(owner[1:], kind="stable")[columns - rows :]


def cheapest_exchanges(costs: FloatArray) -> FloatArray:
    """Return for each row the least additional cost of an assignment in which it has not the column of its own index.

    ``costs`` is square, and the identity its cheapest assignment. Rows may pass columns round in cycles of any length:
    (n, n), whose element (i, j) is for row i with column j, and 0 for i = j. By Floyd's and Warshall's shortest paths.
    """
    apart = costs - np.diagonal(costs)[:, None]  # what it costs row i to take the column of row j
    shortest = np.where(np.eye(len(costs), dtype=bool), 0.0, apart)
    for via in range(len(costs)):
        shortest = np.minimum(shortest, shortest[:, via, None] + shortest[None, via, :])
    exchanges: FloatArray = np.maximum(np.where(np.eye(len(costs), dtype=bool), 0.0, apart + shortest.T), 0.0)
    return exchanges
