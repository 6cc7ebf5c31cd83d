"""The fixed facts of a rearrangement task, as arrays: sizes, goals and the workspace."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.portable import sincos
from dynpf.types import FloatArray

__all__ = ["Layout"]


class Layout(NamedTuple):
    """Part radii (p,), goals (p, 2), and half the size (2,) of a workspace centred at the origin; metres."""

    radii: FloatArray
    goals: FloatArray
    half_size: FloatArray
    robot_radius: float
    reach: float  # gap between the robot and the part it holds

    def grip_distance(self, part: int) -> float:
        """Return the distance d between the centres of the robot and of ``part`` while it is held."""
        return self.robot_radius + float(self.radii[part]) + self.reach

    def held_position(self, pose: FloatArray, part: int) -> FloatArray:
        """Return b = r + d e(theta), (2,), the centre of ``part`` in the gripper of a robot at (x, y, theta)."""
        sine, cosine = sincos(float(pose[2]))
        return pose[:2] + self.grip_distance(part) * np.array([cosine, sine])

    def others(self, part: int) -> NDArray[np.intp]:
        """Return the indices of all parts but one, ascending."""
        return np.delete(np.arange(len(self.radii)), part)
