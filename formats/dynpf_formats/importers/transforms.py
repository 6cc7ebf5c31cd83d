"""Transforms between a robot's frames, as in ROS: a tree of poses in space, and their projection to the plane."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynpf.portable import atan2, product
from dynpf.types import FloatArray
from dynpf_formats.importers.poses import Pose

__all__ = ["OPTICAL", "TransformTree", "matrix", "planar"]

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation (3, 3) of an optical frame (z ahead, x to the right) on a sensor that looks ahead (REP 103)."""


def matrix(translation: Any, rotation: Any) -> FloatArray | None:
    """Return position and quaternion (objects with x, y, z and w) as a matrix (4, 4), or None if they are invalid.

    The quaternion is normalized; a quaternion of length 0 and numbers that are not finite give None.
    """
    q = np.array([rotation.x, rotation.y, rotation.z, rotation.w], dtype=np.float64)
    t = np.array([translation.x, translation.y, translation.z], dtype=np.float64)
    with np.errstate(over="ignore"):  # infinite then, which is no length
        length = float(np.sqrt(np.sum(q * q)))
    if not (np.isfinite(t).all() and math.isfinite(length) and length > 1e-6):
        return None
    x, y, z, w = (q / length).tolist()
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = t
    return found


def planar(transform: FloatArray) -> Pose:
    """Return the pose (m, m, rad) of a frame (4, 4) projected to the plane, by its origin and x axis."""
    x, y = transform[:2, 3].tolist()
    return x, y, atan2(float(transform[1, 0]), float(transform[0, 0]))


class TransformTree:
    """Frames, each with its parent and its newest pose in it."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FloatArray]] = {}

    def put(self, parent: str, child: str, transform: FloatArray) -> None:
        """Set the pose of ``child`` in ``parent``."""
        self._parents[child] = parent, transform

    def frames(self) -> set[str]:
        """Return the names of all frames."""
        return {*self._parents, *(parent for parent, _ in self._parents.values())}

    def parent(self, frame: str) -> str | None:
        """Return the parent of ``frame``, or None."""
        return self._parents[frame][0] if frame in self._parents else None

    def find(self, target: str, source: str) -> FloatArray | None:
        """Return the pose of ``source`` in ``target``, (4, 4); None if the tree does not connect them."""
        up, down = self._ancestors(source), self._ancestors(target)
        for frame, transform in up:
            for other, back in down:
                if frame == other:
                    return product(_inverse(back), transform)
        return None

    def _ancestors(self, frame: str) -> Sequence[tuple[str, FloatArray]]:
        """Return the frame and its ancestors, each with the frame's pose in it."""
        found = [(frame, np.eye(4))]
        while found[-1][0] in self._parents and len(found) <= len(self._parents):
            name, transform = found[-1]
            parent, step = self._parents[name]
            found.append((parent, product(step, transform)))
        return found


def _inverse(transform: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transform (4, 4)."""
    found = np.eye(4)
    found[:3, :3] = transform[:3, :3].T
    found[:3, 3] = -product(found[:3, :3], transform[:3, 3])
    return found
