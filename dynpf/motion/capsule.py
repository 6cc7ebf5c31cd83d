"""Steps of a capsule through a tube: a turn, then a way along the new heading, with noise of constant size."""

from typing import NamedTuple

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.motion.gaussian import draw, float32_rows, identities
from dynpf.params import validated
from dynpf.portable import sincos
from dynpf.rng import Stream
from dynpf.types import Floats, NonNegative

__all__ = ["CapsuleMotion", "CapsuleStep", "CapsuleStepParams"]


class CapsuleMotion(NamedTuple):
    """Turn (rad), then way ``rho`` along the new heading (map units)."""

    rho: float
    turn: float


class CapsuleStepParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule_step"
):
    """Standard deviations of the noise of one step, whatever its length."""

    sigma: NonNegative = 0.1  # map units, of x and of y
    sigma_theta: NonNegative = 0.1  # rad


class CapsuleStep:
    """The motion of COLON: x and y move by rho along theta + turn, independent Gaussian noise on x, y and theta.

    Every step is noisy, one of no length too. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: CapsuleStepParams) -> None:
        self.params = validated(params)

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the poses (3, N) in float32: this model estimates nothing else."""
        return float32_rows(poses)

    def propagate(self, particles: Floats, control: CapsuleMotion, stream: Stream) -> Floats:
        """Return particles (D, N) moved, headings in [-pi, pi]; rows after the third pass through."""
        sigmas = self.params.sigma, self.params.sigma_theta
        return draw(kernels.motion.move_capsule, particles, stream, *control, *sigmas)

    def expected(self, states: Floats, control: CapsuleMotion) -> Floats:
        """Return the states (D, N) after the step; headings are not wrapped."""
        moved = states.copy()
        moved[2] += control.turn
        sine, cosine = sincos(moved[2])
        moved[0] += control.rho * cosine
        moved[1] += control.rho * sine
        return moved

    def jacobian(self, states: Floats, control: CapsuleMotion) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N)."""
        sine, cosine = sincos(states[2] + control.turn)
        jacobian = identities(states)
        jacobian[0, 2] = -control.rho * sine
        jacobian[1, 2] = control.rho * cosine
        return jacobian

    def covariance(self, states: Floats, control: CapsuleMotion) -> Floats:  # noqa: ARG002
        """Return the noise's covariance, the same everywhere, shape (D, D, N)."""
        covariance = np.zeros((len(states), *states.shape), dtype=states.dtype)
        covariance[0, 0] = covariance[1, 1] = self.params.sigma * self.params.sigma
        covariance[2, 2] = self.params.sigma_theta * self.params.sigma_theta
        return covariance
