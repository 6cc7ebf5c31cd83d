"""Point landmarks that can be told from one another."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf.types import FloatArray

__all__ = ["LandmarkMap"]


class LandmarkMap:
    """Identified landmarks: ``ids`` in ascending order and ``positions`` in metres, shape (2, M), in that order.

    ``rows`` are the positions as kernels take them, float32.
    """

    def __init__(self, landmarks: Iterable[tuple[int, float, float]]) -> None:
        """Take (id, x, y) of each; raises ValueError where an id comes twice or a position is not finite."""
        rows = sorted(landmarks)
        self.ids = tuple(row[0] for row in rows)
        self.positions: FloatArray = np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 2).T
        self.rows: NDArray[np.float32] = np.ascontiguousarray(self.positions, dtype=np.float32)
        self._sorted = np.array(self.ids, dtype=np.int64)
        self._column = {identity: column for column, identity in enumerate(self.ids)}
        for first, second in zip(self.ids, self.ids[1:], strict=False):
            if first == second:
                raise ValueError(f"landmark {first} is in the map twice; ids must differ")
        for identity, position in zip(self.ids, self.positions.T, strict=True):
            if not np.isfinite(position).all():
                raise ValueError(f"landmark {identity} lies at {tuple(position.tolist())}; expected finite metres")

    def __contains__(self, identity: int) -> bool:
        return identity in self._column

    def __len__(self) -> int:
        return len(self.ids)

    def position(self, identity: int) -> FloatArray:
        """Return the position of one landmark, shape (2,); raises KeyError when it is not in the map."""
        return self.positions[:, self._column[identity]]

    def columns(self, ids: ArrayLike) -> NDArray[np.int32]:
        """Return the column of each id, shape as ``ids``; -1 where it is not in the map."""
        wanted = np.asarray(ids, dtype=np.int64)
        if not self.ids:
            return np.full(wanted.shape, -1, dtype=np.int32)
        column = np.minimum(np.searchsorted(self._sorted, wanted), len(self.ids) - 1)
        return np.where(self._sorted[column] == wanted, column, -1).astype(np.int32, casting="same_kind")
