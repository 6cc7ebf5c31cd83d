"""Which part takes which goal where parts are interchangeable."""

import numpy as np
from numpy.typing import NDArray

from dynpf.assignment import assign
from dynpf.portable import norm
from dynpf.types import FloatArray

__all__ = ["shared_out"]


def shared_out(parts: FloatArray, goals: FloatArray, kinds: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return for each part the index of its goal, (p,): among those of its kind, with the shortest ways in total.

    ``parts`` and ``goals`` have shape (p, 2); part i's own goal is goal i, and parts of the same ``kinds`` (p,) may
    take each other's.
    """
    if len(set(kinds.tolist())) == len(kinds):
        return np.arange(len(kinds))
    ways = norm(parts[:, None] - goals[None, :], axis=2)
    return assign(np.where(kinds[:, None] == kinds[None, :], ways, np.inf))
