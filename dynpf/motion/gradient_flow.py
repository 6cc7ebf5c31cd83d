"""Motion along a velocity field, as of a robot that descends a potential, with Gaussian process noise."""

from collections.abc import Callable

import msgspec
import numpy as np

from dynpf.motion.gaussian import identities
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Floats, NonNegative, Positive

__all__ = ["Field", "GradientFlow", "GradientFlowParams"]


Field = Callable[[Floats], Floats]
"""Velocities (D, N) of states (D, N): m/s, and rad/s of a heading. Column by column, as the models are."""


class GradientFlowParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="gradient_flow"
):
    """Process noise of one step, whatever its duration, and the step of the differences."""

    variance: NonNegative = 0.06e-4  # m^2, of x and of y: the 0.06 cm^2 of PARTS section 3
    turn_variance: NonNegative = 0.0  # rad^2, of the heading, where the states have one
    difference: Positive = 1e-5  # m and rad, to each side of the state


class GradientFlow:
    """x' = x + field(x) duration + noise, an Euler step of PARTS eq. 3.2 and 3.3; the control is the duration (s).

    States are positions (2, N) or poses (3, N), in either precision; rows after the third are moved by the field
    without noise. Every step is noisy. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: GradientFlowParams, field: Field) -> None:
        self.params = validated(params)
        self.field = field

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the positions (2, N) or poses (3, N) as they are."""
        return poses

    def propagate(self, particles: Floats, control: float, stream: Stream) -> Floats:
        """Return the particles (D, N) moved, with noise; headings are not wrapped."""
        moved = self.expected(particles, control)
        sigmas = np.sqrt(np.array(self._variances(len(moved)), dtype=moved.dtype))
        noise = stream.normals(len(sigmas), moved.shape[1])
        for row, sigma in enumerate(sigmas):
            moved[row] += sigma * noise[row]
        return moved

    def expected(self, states: Floats, control: float) -> Floats:
        """Return x + field(x) duration, shape (D, N); headings are not wrapped."""
        return states + (self.field(states) * control).astype(states.dtype, copy=False)

    def jacobian(self, states: Floats, control: float) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N).

        By central differences of the field in float64: 2 D evaluations, and an error of difference^2 / 6 times the
        field's third derivative, less than the field's own rounding where it is smooth over some millimetres.
        """
        step = self.params.difference
        jacobian = identities(states)
        for column in range(len(states)):
            ahead, behind = states.astype(np.float64), states.astype(np.float64)
            ahead[column] += step
            behind[column] -= step
            jacobian[:, column] += (self.field(ahead) - self.field(behind)) * (control / (2.0 * step))
        return jacobian

    def covariance(self, states: Floats, control: float) -> Floats:  # noqa: ARG002
        """Return the noise's covariance, the same everywhere, shape (D, D, N)."""
        covariance = np.zeros((len(states), *states.shape), dtype=states.dtype)
        for row, variance in enumerate(self._variances(len(states))):
            covariance[row, row] = variance
        return covariance

    def _variances(self, dimension: int) -> tuple[float, ...]:
        return (self.params.variance, self.params.variance, self.params.turn_variance)[:dimension]
