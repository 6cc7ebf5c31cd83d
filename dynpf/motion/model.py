"""What a filter asks of a motion model, and the controls that say how a robot moved."""

from typing import NamedTuple, Protocol, TypeVar

from dynpf.rng import Stream
from dynpf.types import Floats

__all__ = ["Displacement", "GaussianMotion", "MotionModel", "Twist"]

ControlT_contra = TypeVar("ControlT_contra", contravariant=True)


class Twist(NamedTuple):
    """Forward speed (m/s) and turning rate (rad/s), held for a duration (s)."""

    v: float
    w: float
    duration: float


class Displacement(NamedTuple):
    """Pose after a movement in the frame of the pose before it, as wheel odometry reports it: metres and radians."""

    dx: float
    dy: float
    turn: float


class MotionModel(Protocol[ControlT_contra]):
    """Moves particles, columns of a (D, N) array: x, y and theta, then whatever else the model estimates.

    Every column is moved by itself, with its own column of the stream's numbers, so that particles may be moved in
    batches of any size.
    """

    def particles(self, poses: Floats, stream: Stream) -> Floats:
        """Return poses (3, N) as particles (D, N), the further rows drawn from the model's prior."""

    def propagate(self, particles: Floats, control: ControlT_contra, stream: Stream) -> Floats:
        """Return draws from p(state after the control | particle, control), shape (D, N)."""


class GaussianMotion(MotionModel[ControlT_contra], Protocol[ControlT_contra]):
    """A motion whose density is Gaussian, exactly or to first order in the noise: f(x, u) plus noise."""

    def expected(self, states: Floats, control: ControlT_contra) -> Floats:
        """Return f(x, u), where the states (D, N) would be without noise, shape (D, N)."""

    def jacobian(self, states: Floats, control: ControlT_contra) -> Floats:
        """Return df/dx at the states (D, N), shape (D, D, N)."""

    def covariance(self, states: Floats, control: ControlT_contra) -> Floats:
        """Return the covariance of the noise that is added to f, shape (D, D, N)."""
