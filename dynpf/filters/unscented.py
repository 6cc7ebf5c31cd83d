"""The unscented Kalman filter: a Gaussian belief carried through the models by points that stand for it.

The points and weights are the scaled ones (Wan and van der Merwe, 2000): the mean, and the mean plus and minus the
columns of sqrt((D + lambda) P) by Cholesky, lambda = alpha^2 (D + kappa) - D. A point beside the mean weighs
w = 1 / (2 (D + lambda)); the mean weighs lambda / (D + lambda) in means and 1 - alpha^2 + beta more in covariances.

The sums are taken over the differences d_i between what becomes of the points and what becomes of the mean, y_0:

    mean = y_0 + s  with  s = w sum d_i,    covariance = w sum d_i d_i^T + (beta - alpha^2) s s^T

This is the same in exact arithmetic, but has no large weights of opposite signs to cancel, is a sum of squares, and
lets an angle be wrapped where it is well defined: in a difference. The points of an update are drawn anew from the
predicted belief, so that they include the process noise.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.filters import kalman
from dynpf.filters.kalman import Gaussian, Innovation
from dynpf.measurement.model import GaussianMeasurement
from dynpf.motion.model import GaussianMotion
from dynpf.params import validated
from dynpf.se2 import FloatArray, wrap_angle

__all__ = ["UnscentedKalman", "UnscentedKalmanParams"]

ControlT = TypeVar("ControlT")


class UnscentedKalmanParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="unscented_kalman"
):
    """Where the points lie and what they weigh, and which rows of the state are angles."""

    alpha: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0  # the points lie alpha sqrt(D + kappa) deviations out
    beta: Annotated[float, Meta(ge=0.0)] = 2.0  # 2 suits a Gaussian belief; at least alpha^2
    kappa: float = 0.0  # more than -D
    angles: tuple[Annotated[int, Meta(ge=0)], ...] = (2,)


class UnscentedKalman(Generic[ControlT]):
    """A Gaussian motion, and a Gaussian measurement for each type of reading. The belief goes in and comes out.

    The models' Jacobians are not asked for. Raises ValueError when beta < alpha^2: covariances could become indefinite.
    """

    def __init__(
        self,
        motion: GaussianMotion[ControlT],
        measurements: Mapping[type, GaussianMeasurement[Any]],
        params: UnscentedKalmanParams | None = None,
    ) -> None:
        self.motion = motion
        self.measurements = dict(measurements)
        self.params = validated(params or UnscentedKalmanParams())
        self._curvature = self.params.beta - self.params.alpha**2
        if self._curvature < 0.0:
            raise ValueError(
                f"UnscentedKalmanParams.beta = {self.params.beta}: expected at least alpha^2 = {self.params.alpha**2}"
            )

    def predict(self, belief: Gaussian, control: ControlT) -> Gaussian:
        """Return the belief after the control; raises ValueError when it is not finite.

        Headings may spread up to a deviation of pi / (alpha sqrt(D + kappa)); beyond that the points meet behind.
        """
        spread, offsets = self._offsets(belief)
        moved = np.asarray(self.motion.expected(_around(belief.mean, offsets), control), dtype=np.float64)
        process = np.asarray(self.motion.covariance(belief.mean[:, None], control), dtype=np.float64)[:, :, 0]
        differences = kalman.wrap_rows(moved[:, 1:] - moved[:, :1], self.params.angles)
        shift = differences.sum(axis=1) / (2.0 * spread)
        covariance = self._covariance(differences, shift, spread) + process
        return kalman.as_belief(moved[:, 0] + shift, covariance, self.params.angles)

    def update(self, belief: Gaussian, reading: object, gate: float | None = None) -> tuple[Gaussian, Innovation]:
        """Return the belief given the reading, and the innovation.

        The belief stays as it was when the measurement model admits nothing, when the innovation is not finite, or when
        its squared Mahalanobis distance exceeds ``gate``. Raises KeyError for a type of reading that has no model,
        numpy.linalg.LinAlgError when the innovation covariance is singular.
        """
        model = self.measurements[type(reading)]
        reading = kalman.admitted(model, belief, reading)
        if reading is None:
            return belief, kalman.NOTHING_ADMITTED
        noise = np.asarray(model.noise(reading), dtype=np.float64)
        spread, offsets = self._offsets(belief)
        innovations = np.asarray(model.innovation(_around(belief.mean, offsets), reading), dtype=np.float64)
        if not np.isfinite(innovations).all():
            return belief, kalman.judged(innovations[:, 0], np.full_like(noise, np.nan), gate)
        angular = model.angular(reading)
        differences = innovations[:, 1:] - innovations[:, :1]
        differences[angular] = wrap_angle(differences[angular])
        shift = differences.sum(axis=1) / (2.0 * spread)
        vector = innovations[:, 0] + shift
        vector[angular] = wrap_angle(vector[angular])
        innovation_covariance = self._covariance(differences, shift, spread) + noise
        innovation = kalman.judged(vector, innovation_covariance, gate)
        if not innovation.used:
            return belief, innovation
        # The innovation is the measured minus the expected: it falls where the expectation rises.
        cross = -(offsets @ differences.T) / (2.0 * spread)
        weight = np.linalg.solve(innovation_covariance, cross.T).T
        # As in Joseph's form, a sum of squares.
        covariance = (
            self._covariance(offsets + weight @ differences, weight @ shift, spread) + weight @ noise @ weight.T
        )
        return kalman.as_belief(belief.mean + weight @ vector, covariance, self.params.angles), innovation

    def _offsets(self, belief: Gaussian) -> tuple[float, FloatArray]:
        """Return D + lambda, and the points' offsets from the mean, shape (D, 2 D)."""
        dimension = belief.mean.size
        if dimension + self.params.kappa <= 0.0:
            raise ValueError(f"kappa = {self.params.kappa}: expected more than minus the state's {dimension} rows")
        spread = self.params.alpha**2 * (dimension + self.params.kappa)
        return spread, kalman.symmetric_offsets(belief.covariance, spread)

    def _covariance(self, differences: FloatArray, shift: FloatArray, spread: float) -> FloatArray:
        covariance: FloatArray = differences @ differences.T / (2.0 * spread)
        return covariance + self._curvature * np.outer(shift, shift)


def _around(mean: FloatArray, offsets: FloatArray) -> FloatArray:
    """Return the points, shape (D, 2 D + 1), the mean first."""
    return mean[:, None] + np.concatenate((np.zeros((mean.size, 1)), offsets), axis=1)
