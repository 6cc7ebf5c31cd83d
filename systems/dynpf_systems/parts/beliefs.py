"""What the controller looks at, estimates as arrays, and what it does next: subtasks and one tick's motion."""

import math
from typing import NamedTuple, Protocol

import numpy as np
from dynpf_protocol.messages import Estimate
from dynpf_runtime.node import State
from numpy.typing import NDArray

from dynpf.fields.laws import Margins
from dynpf.portable import norm
from dynpf.types import FloatArray
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.messages import PartsEstimate

__all__ = ["Construction", "Motion", "Scene", "Subtask", "margins_of"]


class Scene(NamedTuple):
    """Pose (3,), parts (p, 2), and standard deviations of each coordinate, of the robot and of the parts (p,)."""

    pose: FloatArray
    robot_sigma: float
    parts: FloatArray
    sigmas: FloatArray
    held: int

    @classmethod
    def of(cls, estimate: Estimate, parts: PartsEstimate) -> "Scene":
        return cls(
            pose=np.array([estimate.x, estimate.y, estimate.theta]),
            robot_sigma=math.sqrt(max(estimate.covariance[0] + estimate.covariance[4], 0.0) / 2.0),
            parts=np.array([(part.x, part.y) for part in parts.parts]).reshape(-1, 2),
            sigmas=np.sqrt(np.array([part.variance for part in parts.parts])),
            held=parts.held,
        )

    def sigmas_between(self, most: float) -> FloatArray:
        """Return the deviation, at most ``most``, of the robot's place relative to each part's, (p,)."""
        both: FloatArray = np.minimum(np.sqrt(self.robot_sigma * self.robot_sigma + self.sigmas * self.sigmas), most)
        return both

    def bearing_sigma(self, part: int, most: float) -> float:
        """Return the deviation of the direction from robot to ``part``, if positions deviate by ``most`` at most."""
        distance: float = norm(self.parts[part] - self.pose[:2])
        return float(self.sigmas_between(most)[part]) / max(distance, most)


def margins_of(scene: Scene, config: RearrangementControllerConfig) -> Margins:
    """Return the clearances to be kept: more where less is known."""
    return Margins(
        parts=config.margin + config.margin_sigmas * scene.sigmas_between(config.max_sigma),
        walls=config.margin + config.margin_sigmas * min(scene.robot_sigma, config.max_sigma),
    )


class Subtask(NamedTuple):
    """Take ``part`` to ``goal``, (2,): its own, or a place where it is out of the way (``parked``).

    ``direction``: of the gripper when it takes the part, for constructions that choose one.
    """

    part: int
    goal: FloatArray
    parked: bool = False
    direction: float = math.nan


class Motion(NamedTuple):
    """One tick's step in (x, y, theta), the potential that it descends, and whether that has just been made anew."""

    step: FloatArray
    potential: float
    anew: bool = False


class Construction(Protocol):
    """A family of potentials: which part is next, and how to mate with it and move it.

    ``progress`` is the fall of the potential that tells progress from noise. ``freeze`` and ``thaw`` are for what
    the steps remember, as a node's.
    """

    @property
    def progress(self) -> float: ...

    def choose(
        self, scene: Scene, away: NDArray[np.intp], stalls: NDArray[np.int64], *, make_way: bool
    ) -> Subtask | None:
        """Return what to do first about the parts ``away``, those with the fewest stalls before others; or nothing.

        ``make_way``: a part may be moved aside for others.
        """
        ...

    def mate(self, scene: Scene, subtask: Subtask) -> Motion | None:
        """Return the step towards gripping the part; None when this is no longer possible."""
        ...

    def move(self, scene: Scene, subtask: Subtask) -> Motion: ...

    def freeze(self) -> State: ...

    def thaw(self, state: State) -> None: ...
