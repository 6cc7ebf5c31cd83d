"""The controller's view of the estimates, as arrays, and its decisions: subtasks and one tick's motion."""

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
from dynpf_systems.parts.messages import Identities, PartsEstimate

__all__ = ["Construction", "Motion", "Scene", "Subtask", "margins_of"]


class Scene(NamedTuple):
    """Pose (3,) of the robot, positions (p, 2) of the parts, and standard deviations of their coordinates.

    ``identities`` are the probabilities that the discs taken for robot and parts are these, (p + 1,), and
    ``robot_among`` the parts whose disc may be the robot instead.
    """

    pose: FloatArray
    robot_sigma: float
    parts: FloatArray
    sigmas: FloatArray
    held: int
    identities: FloatArray
    robot_among: tuple[int, ...] = ()

    @classmethod
    def of(cls, estimate: Estimate, parts: PartsEstimate, identities: Identities | None) -> "Scene":
        """Return the scene of estimates with the same stamp; without ``identities`` nothing looks alike."""
        certain = [1.0] * (len(parts.parts) + 1)
        return cls(
            pose=np.array([estimate.x, estimate.y, estimate.theta]),
            robot_sigma=math.sqrt(max(estimate.covariance[0] + estimate.covariance[4], 0.0) / 2.0),
            parts=np.array([(part.x, part.y) for part in parts.parts]).reshape(-1, 2),
            sigmas=np.sqrt(np.array([part.variance for part in parts.parts])),
            held=parts.held,
            identities=np.array(certain if identities is None else [identities.robot, *identities.parts]),
            robot_among=() if identities is None else identities.robot_among,
        )

    def sigmas_between(self, most: float) -> FloatArray:
        """Return the standard deviation, at most ``most``, of the robot's position relative to each part's, (p,)."""
        both: FloatArray = np.minimum(np.sqrt(self.robot_sigma * self.robot_sigma + self.sigmas * self.sigmas), most)
        return both

    def bearing_sigma(self, part: int, most: float) -> float:
        """Return the standard deviation of the bearing of ``part``, if that of positions is at most ``most``."""
        distance: float = norm(self.parts[part] - self.pose[:2])
        return float(self.sigmas_between(most)[part]) / max(distance, most)


def margins_of(scene: Scene, config: RearrangementControllerConfig) -> Margins:
    """Return the clearances to be kept, which grow with the standard deviations."""
    return Margins(
        parts=config.margin + config.margin_sigmas * scene.sigmas_between(config.max_sigma),
        walls=config.margin + config.margin_sigmas * min(scene.robot_sigma, config.max_sigma),
    )


class Subtask(NamedTuple):
    """Take ``part`` to ``goal``, (2,): its own, or a parking position out of the way (``parked``).

    ``direction`` is the gripper's when it takes the part, for constructions that choose it.
    """

    part: int
    goal: FloatArray
    parked: bool = False
    direction: float = math.nan


class Motion(NamedTuple):
    """One tick's step in (x, y, theta), the potential that it descends, and whether that has just been solved again."""

    step: FloatArray
    potential: float
    renewed: bool = False


class Construction(Protocol):
    """A family of potentials: it chooses the next part, and how to mate with it and move it.

    ``progress`` is the decrease of the potential that counts as progress rather than noise. ``freeze`` and ``thaw`` are
    those of a node, for the state between steps.
    """

    @property
    def progress(self) -> float:
        """The decrease of the potential that counts as progress."""
        ...

    def choose(
        self, scene: Scene, away: NDArray[np.intp], stalls: NDArray[np.int64], *, make_way: bool
    ) -> Subtask | None:
        """Return the next subtask for the parts ``away``, those with the fewest stalls first; None without any.

        With ``make_way`` a part may be moved aside for others.
        """
        ...

    def mate(self, scene: Scene, subtask: Subtask) -> Motion | None:
        """Return the step towards gripping the part; None when that is no longer possible."""
        ...

    def move(self, scene: Scene, subtask: Subtask) -> Motion:
        """Return the step that moves the held part towards the subtask's goal."""
        ...

    def freeze(self) -> State:
        """Return the state between steps."""
        ...

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        ...
