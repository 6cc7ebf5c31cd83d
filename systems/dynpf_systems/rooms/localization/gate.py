"""Odometry that no robot can have driven: one broken record among sound ones, or a pose that was set anew."""

from typing import NamedTuple

import numpy as np
from dynpf_runtime.node import State

from dynpf.types import FloatArray

__all__ = ["FASTEST", "Gate", "Verdict"]

FASTEST = 100.0  # m/s, and rad/s: faster than anything that is localized with this
SLACK_M = 1.0  # what stamps that come in bursts may add to a way


class Verdict(NamedTuple):
    """Whether odometry is believed, and since which pose a believed one has moved, None for the first."""

    believed: bool
    since: FloatArray | None = None


class Gate:
    """Judges odometry by the speed that it claims; ``left_out`` counts what it does not believe.

    A pose is doubted that is too far from the last believed one. If the next is near the doubted one, the odometry was
    set anew, by somebody or by a first pose that was itself wrong: it is believed again from the doubted pose on.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self._doubted: FloatArray | None = None

    def twist(self, v: float, w: float) -> bool:
        """Return whether a velocity (m/s) and a turning rate (rad/s) are possible."""
        possible = abs(v) <= FASTEST and abs(w) <= FASTEST
        self.left_out += not possible
        return possible

    def pose(self, last: FloatArray | None, pose: FloatArray, duration_s: float) -> Verdict:
        """Judge a pose (3,) by the last believed one, ``duration_s`` before it."""
        doubted, self._doubted = self._doubted, None
        if last is None or _near(last, pose, duration_s):
            return Verdict(True, last)
        if doubted is not None and _near(doubted, pose, duration_s):
            return Verdict(True, doubted)
        self._doubted = pose
        self.left_out += 1
        return Verdict(False)

    def freeze(self) -> State:
        """Return what is doubted and how much was left out; nothing as long as nothing was."""
        return {"doubted": self._doubted, "left_out": self.left_out} if self.left_out else {}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        doubted = state.get("doubted")
        self._doubted = None if doubted is None else np.array(doubted)
        self.left_out = state.get("left_out", 0)


def _near(since: FloatArray, pose: FloatArray, duration_s: float) -> bool:
    most = SLACK_M + FASTEST * max(duration_s, 0.0)
    return bool((np.abs(pose[:2] - since[:2]) <= most).all())
