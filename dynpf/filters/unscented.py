"""The unscented Kalman filter: a Gaussian belief carried through the models by points that stand for it.

The points and weights are the scaled ones (Wan and van der Merwe, 2000): the mean, and the mean plus and minus the
columns of sqrt((D + lambda) P) by Cholesky, lambda = alpha^2 (D + kappa) - D. A point beside the mean weighs
w = 1 / (2 (D + lambda)); the mean weighs lambda / (D + lambda) in means and 1 - alpha^2 + beta more in covariances.

The sums are taken over the differences d_i between what becomes of the points and what becomes of the mean, y_0:

    mean = y_0 + s  with  s = w sum d_i,    covariance = w sum d_i d_i^T + (beta - alpha^2) s s^T

This is the same in exact arithmetic, but has no large weights of opposite signs to cancel, is a sum of squares, and
lets an angle be wrapped where it is well defined: in a difference. The points of an update are drawn again from the
predicted belief, so that they include the process noise.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels
from dynpf.covariance import negative_eigenvalue
from dynpf.filters import kalman
from dynpf.filters.kalman import Gaussian, Innovation
from dynpf.filters.shapes import shaped
from dynpf.measurement.model import GaussianMeasurement
from dynpf.motion.model import GaussianMotion
from dynpf.params import validated
from dynpf.types import FloatArray, NonNegative, Rate

__all__ = ["UnscentedKalman", "UnscentedKalmanParams"]

ControlT = TypeVar("ControlT")


class UnscentedKalmanParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="unscented_kalman"
):
    """Where the points lie and what they weigh, and which rows of the state are angles."""

    alpha: Rate = 1.0  # the points lie alpha sqrt(D + kappa) deviations out
    beta: NonNegative = 2.0  # 2 suits a Gaussian belief; at least alpha^2
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
        self._angles = np.array(self.params.angles, dtype=np.int64)
        squared = self.params.alpha * self.params.alpha
        self._curvature = self.params.beta - squared
        if self._curvature < 0.0:
            raise ValueError(f"UnscentedKalmanParams.beta = {self.params.beta}: expected at least alpha^2 = {squared}")

    def predict(self, belief: Gaussian, control: ControlT) -> Gaussian:
        """Return the belief after the control; raises ValueError when it is not finite.

        Headings may spread up to a deviation of pi / (alpha sqrt(D + kappa)); beyond that the points meet behind.
        """
        spread, _, points = self._points(belief)
        size = belief.mean.size
        moved = shaped("the states that a motion expects", self.motion.expected(points, control), *points.shape)
        process = shaped("a process covariance", self.motion.covariance(belief.mean[:, None], control), size, size, 1)
        after = Gaussian(np.empty(size), np.empty((size, size)))
        settings = spread, self._curvature, process[:, :, 0], self._angles
        if not kernels.gaussian.unscented_predict(moved, *settings, *after):
            raise kalman.not_finite(after)
        return after

    def update(self, belief: Gaussian, reading: object, gate: float | None = None) -> tuple[Gaussian, Innovation]:
        """Return the belief given the reading, and the innovation.

        The belief stays as it was when the measurement model admits nothing, when the innovation is not finite, or when
        its squared Mahalanobis distance exceeds ``gate``. Raises KeyError for a type of reading that has no model,
        SingularMatrixError when the innovation covariance is singular.
        """
        model = self.measurements[type(reading)]
        reading = kalman.admitted(model, belief, reading)
        if reading is None:
            return belief, kalman.NOTHING_ADMITTED
        spread, offsets, points = self._points(belief)
        angular = np.array(model.angular(reading), dtype=np.bool_)
        rows = angular.size
        noise = shaped("a measurement covariance", model.noise(reading), rows, rows)
        innovations = shaped("innovations", model.innovation(points, reading), rows, points.shape[1])
        if not np.isfinite(innovations).all():
            return belief, kalman.judged(innovations[:, 0], np.full_like(noise, np.nan), gate)
        # Of what the points expect: how much it differs from what the mean does, and the mean of that.
        differences, shift = np.empty((rows, offsets.shape[1])), np.empty(rows)
        vector, covariance = np.empty(rows), np.empty((rows, rows))
        settings, found = (spread, self._curvature, noise), (differences, shift, vector, covariance)
        expectation = kernels.gaussian.unscented_expect(innovations, angular, *settings, *found)
        innovation = kalman.weighed(vector, covariance, expectation, gate)
        if not innovation.used:
            return belief, innovation
        after = Gaussian(np.empty(belief.mean.shape), np.empty(belief.covariance.shape))
        mean = np.ascontiguousarray(points[:, 0])
        if not kernels.gaussian.unscented_correct(mean, offsets, *settings, *found, self._angles, *after):
            raise kalman.not_finite(after)
        return after, innovation

    def _points(self, belief: Gaussian) -> tuple[float, FloatArray, FloatArray]:
        """Return D + lambda, the points' offsets from the mean (D, 2 D), and the points (D, 2 D + 1), the mean first.

        Raises ValueError for a kappa that does not suit D, and for a covariance with a negative eigenvalue.
        """
        dimension = belief.mean.size
        if dimension + self.params.kappa <= 0.0:
            raise ValueError(f"kappa = {self.params.kappa}: expected more than minus the state's {dimension} rows")
        spread = self.params.alpha * self.params.alpha * (dimension + self.params.kappa)
        offsets, points = np.empty((dimension, 2 * dimension)), np.empty((dimension, 2 * dimension + 1))
        mean = shaped("a mean", belief.mean, dimension)
        covariance = shaped("a covariance", belief.covariance, dimension, dimension)
        if not kernels.gaussian.sigma_points(mean, covariance, spread, offsets, points):
            raise negative_eigenvalue(covariance)
        return spread, offsets, points
