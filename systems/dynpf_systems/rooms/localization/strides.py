"""Motion put together to strides: what odometry's many small movements come to.

The error of odometry goes by the way that the robot makes, not by how often odometry is read. So the records since the
last stride are composed to one displacement, and the filter adds the noise of that: neither their rate nor their jitter
counts.
"""

from typing import NamedTuple

import numpy as np
from dynpf_runtime.node import State

from dynpf.motion.model import Displacement, Twist
from dynpf.portable import hypot
from dynpf.se2 import arc_displacement, compose
from dynpf.types import FloatArray
from dynpf_systems.rooms.localization.components import Moved
from dynpf_systems.rooms.localization.config import StepParams

__all__ = ["Strides"]


class _Way(NamedTuple):
    """A displacement (3,) in the frame of where it began, and how long it has taken, s."""

    net: FloatArray
    duration: float

    def after(self, moved: Twist | Moved) -> "_Way":
        """Return the way with a movement more."""
        if isinstance(moved, Twist):
            step = arc_displacement(moved.v * moved.duration, moved.w * moved.duration)
        else:
            step = np.array(moved.displacement)
        return _Way(compose(self.net, step), self.duration + moved.duration)

    @property
    def made(self) -> tuple[float, float]:
        """Distance (m) and turn (rad)."""
        return hypot(float(self.net[0]), float(self.net[1])), abs(float(self.net[2]))


class Strides:
    """The motion that the filter has not been given yet, and the way since its last update."""

    def __init__(self, params: StepParams) -> None:
        self._params = params
        self._pending = _STILL
        self._since: _Way | None = None

    def take(self, moved: Twist | Moved) -> Moved | None:
        """Take a movement; return a stride once it is one."""
        self._pending = self._pending.after(moved)
        if self._since is not None:
            self._since = self._since.after(moved)
        way, turn = self._pending.made
        return self.rest() if way >= self._params.travel or turn >= self._params.turn else None

    def rest(self) -> Moved | None:
        """Return what is not a stride yet, as one; None if there is nothing. The next begins here."""
        pending, self._pending = self._pending, _STILL
        return None if pending.duration == 0.0 else _moved(pending)

    @property
    def begun(self) -> Moved | None:
        """The motion that is not a stride yet; None if there is none."""
        return None if self._pending.duration == 0.0 else _moved(self._pending)

    def mark(self) -> None:
        """Count the way from here on."""
        self._since = _STILL

    def forget(self) -> None:
        """Forget all motion: the pose of now is known in another way."""
        self._pending, self._since = _STILL, None

    @property
    def travelled(self) -> tuple[float, float] | None:
        """Net distance (m) and turn (rad) since the last mark; None before the first."""
        return None if self._since is None else self._since.made

    def freeze(self) -> State:
        """Return the motion pending, and the way since the last mark."""
        since = None if self._since is None else [self._since.net, self._since.duration]
        return {"pending": [self._pending.net, self._pending.duration], "since": since}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        pending, since = state["pending"], state["since"]
        self._pending = _Way(np.array(pending[0]), pending[1])
        self._since = None if since is None else _Way(np.array(since[0]), since[1])


_STILL = _Way(np.zeros(3), 0.0)


def _moved(way: _Way) -> Moved:
    return Moved(Displacement(*way.net.tolist()), way.duration)
