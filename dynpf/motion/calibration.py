"""Calibration estimated with the pose: further rows of the particles, by which odometry and readings are corrected.

A wheel base that is off, or wheels that slip when turning, scale every turn that odometry reports; a camera that is
mounted askew shifts every bearing. Such errors hardly change over a run, so a filter that carries them learns what it
would otherwise have to call noise.
"""

import math

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.motion.arcs import ArcsParams, arc, arc_jacobian, arc_noise, arc_slopes, follow_arc
from dynpf.motion.gaussian import draw, float32_rows, noise_covariance
from dynpf.motion.model import Twist
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Floats, NonNegative

__all__ = [
    "BEARING_BIAS",
    "LAG",
    "RANGE_SCALE",
    "TURN_SCALE",
    "WAY_SCALE",
    "CalibratedArcs",
    "CalibrationParams",
]

TURN_SCALE, WAY_SCALE, BEARING_BIAS, RANGE_SCALE, LAG = 3, 4, 5, 6, 7
"""Rows of a particle: true over odometry's turning rate, and speed; what is added to each bearing (rad), and what
multiplies each range that is read; and, if wanted, how much later than expected the robot does as odometry says (s)."""

_HELD = slice(8, 10)  # with a lag: speed (m/s) and turning rate (rad/s) that held before
_NOMINAL = np.array([1.0, 1.0, 0.0, 1.0])


class CalibrationParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Standard deviations, of the prior around a calibration that is right, and of the random walk.

    A walk is per square root of a second. What has neither stays as it is. The defaults were chosen on data sets 7 and
    9 of UTIAS MRCLAM, whose robots turn by up to a tenth less than their odometry says.
    """

    turn_scale_sigma: NonNegative = 0.1
    turn_scale_walk: NonNegative = 0.004
    way_scale_sigma: NonNegative = 0.0
    way_scale_walk: NonNegative = 0.0
    bearing_bias_sigma: NonNegative = 0.0  # rad, of readings of landmarks with identities; so is the range's
    bearing_bias_walk: NonNegative = 0.0  # rad
    range_scale_sigma: NonNegative = 0.0
    range_scale_walk: NonNegative = 0.0
    lag_sigma: NonNegative = 0.0  # s, around the estimator's odometry_delay; it does not walk


class CalibratedArcs:
    """Motion along arcs whose length and turn are scaled, particle by particle, by estimated factors.

    The noise goes by the twist as given, the same for all particles: were it scaled too, particles of a small scale
    would spread less, keep more weight for that alone, and draw the estimate of the scale down. While the robot rests
    the calibration rests too: nothing would be seen that could correct it. A particle with a lag goes on with the twist
    that held before for so long; its step is taken for one arc, which is true to first order. Raises ValueError for
    parameters out of range.
    """

    def __init__(self, params: ArcsParams, calibration: CalibrationParams) -> None:
        self.params = validated(params)
        self.calibration = validated(calibration)
        walks = (priors := self.calibration).turn_scale_walk, priors.way_scale_walk, priors.bearing_bias_walk
        self._walks = np.array([*walks, priors.range_scale_walk])[:, None]
        self._lags = priors.lag_sigma > 0.0

    def particles(self, poses: Floats, stream: Stream) -> Floats:
        """Return poses (3, N) with calibrations drawn from their priors, (7, N) or with a lag (10, N), float32."""
        priors = self.calibration
        scales = priors.turn_scale_sigma, priors.way_scale_sigma
        sigmas = np.array([*scales, priors.bearing_bias_sigma, priors.range_scale_sigma])
        drawn = _NOMINAL[:, None] + sigmas[:, None] * stream.normals(4, poses.shape[1])
        rows = [float32_rows(poses), float32_rows(drawn)]
        if self._lags:
            lags = priors.lag_sigma * stream.part("lag").normals(1, poses.shape[1])
            rows += [float32_rows(lags), np.zeros((2, poses.shape[1]), dtype=np.float32)]
        return np.concatenate(rows)

    def propagate(self, particles: Floats, control: Twist, stream: Stream) -> Floats:
        """Return particles moved, each by its own calibration, and the calibrations one step further on their walks."""
        before = float32_rows(particles)
        own = [float32_rows(row) for row in self._arcs(before, control)]
        sigmas = map(math.sqrt, arc_noise(self.params, control))
        after = draw(kernels.motion.follow_own_arcs, before, stream, *sigmas, own=own)
        if self._walks.any() and _moves(control):
            noise = stream.part("walk").normals(4, before.shape[1])
            after[TURN_SCALE : RANGE_SCALE + 1] += float32_rows(self._walks * math.sqrt(control.duration)) * noise
        return self._holding(after, control)

    def expected(self, states: Floats, control: Twist) -> Floats:
        """Return the states at the end of their arcs; headings are not wrapped."""
        return self._holding(follow_arc(states, *self._arcs(states, control)), control)

    def jacobian(self, states: Floats, control: Twist) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N)."""
        lengths, turns = self._arcs(states, control)
        jacobian = arc_jacobian(states, lengths, turns)
        by_length, by_turn, _ = arc_slopes(states, lengths, turns)
        turn_scale, way_scale = states[TURN_SCALE], states[WAY_SCALE]
        length, turn = self._uncorrected(states, control)
        jacobian[:3, TURN_SCALE] = turn * by_turn[:3]
        jacobian[:3, WAY_SCALE] = length * by_length[:3]
        if self._lags:
            (v, w), lag = states[_HELD], states[LAG]
            by_v, by_w = way_scale * by_length[:3], turn_scale * by_turn[:3]
            jacobian[:3, LAG] = (v - control.v) * by_v + (w - control.w) * by_w
            jacobian[:3, 8], jacobian[:3, 9] = lag * by_v, lag * by_w
            jacobian[8, 8] = jacobian[9, 9] = 0.0
        return jacobian

    def covariance(self, states: Floats, control: Twist) -> Floats:
        """Return the noise's covariance to first order, shape (D, D, N)."""
        slopes = arc_slopes(states[:3], *self._arcs(states, control))
        of_pose = noise_covariance(slopes, arc_noise(self.params, control))
        covariance = np.zeros((len(states), *states.shape), dtype=of_pose.dtype)
        covariance[:3, :3] = of_pose
        if _moves(control):
            for row, walk in enumerate(self._walks[:, 0].tolist(), start=TURN_SCALE):
                covariance[row, row] = walk * walk * control.duration
        return covariance

    def _uncorrected(self, states: Floats, control: Twist) -> tuple[float | Floats, float | Floats]:
        """Return length and turn as odometry has them: those of the twist, but for the lag those of the one before."""
        length, turn = arc(control)
        if not self._lags:
            return length, turn
        (v, w), lag = states[_HELD], states[LAG]
        return length + (v - control.v) * lag, turn + (w - control.w) * lag

    def _arcs(self, states: Floats, control: Twist) -> tuple[Floats, Floats]:
        """Return length and turn of each state's arc."""
        length, turn = self._uncorrected(states, control)
        return length * states[WAY_SCALE], turn * states[TURN_SCALE]

    def _holding(self, states: Floats, control: Twist) -> Floats:
        """Return the states, to which the twist is now the one that holds."""
        if self._lags:
            states[_HELD] = np.array([[control.v], [control.w]])
        return states


def _moves(control: Twist) -> bool:
    return control.v != 0.0 or control.w != 0.0
