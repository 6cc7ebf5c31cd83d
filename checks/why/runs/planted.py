"""Nodes of runs with a planted failure."""

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from dynpf_lab import Message, Moment, Node
from dynpf_protocol.messages import Estimate, Odometry, RobotState
from dynpf_systems.parts.messages import PartEstimate, PartsEstimate, PartsState


class SlippingWheels(Node, frozen=True, kw_only=True):
    """Odometry whose speed has great noise in the ticks from ``first`` to ``last``, and hardly any else."""

    reads = ("truth/robot",)
    writes: ClassVar[Mapping[str, type[Message]]] = {"sensors/odometry": Odometry}
    first: int
    last: int
    std: float = 0.005  # m/s
    slipping_std: float = 2.4  # m/s

    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Message]]:
        truth = moment.newest(RobotState)
        if truth is None:
            return state, ()
        std = self.slipping_std if self.first <= moment.tick <= self.last else self.std
        return state, (Odometry(v=truth.v + std * moment.draws().standard_normal(), w=truth.w),)


class MeasuredPositions(Node, frozen=True, kw_only=True):
    """An estimator without a filter: the true positions with the noise of a measurement."""

    reads = ("truth/robot", "truth/parts")
    writes: ClassVar[Mapping[str, type[Message]]] = {"parts": PartsEstimate, "state": Estimate}
    variance: float  # m^2

    def step(self, state: Any, moment: Moment) -> tuple[Any, Iterable[Message]]:
        robot, parts = moment.newest(RobotState), moment.newest(PartsState)
        if robot is None or parts is None:
            return state, ()
        noise = (self.variance**0.5 * moment.draws().standard_normal((len(parts.parts) + 1, 2))).tolist()
        found = tuple(
            PartEstimate(x=part.x + dx, y=part.y + dy, variance=self.variance, seen=True)
            for part, (dx, dy) in zip(parts.parts, noise[1:], strict=True)
        )
        variance = self.variance
        covariance = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0)
        x, y = robot.x + noise[0][0], robot.y + noise[0][1]
        estimate = Estimate(x=x, y=y, theta=robot.theta, covariance=covariance, n_eff=1.0)
        return state, (PartsEstimate(parts=found, held=parts.held), estimate)
