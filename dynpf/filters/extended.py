"""The extended Kalman filter: a Gaussian belief carried through models made linear where the belief is."""

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
from dynpf.portable import product
from dynpf.types import Count, FloatArray

__all__ = ["ExtendedKalman", "ExtendedKalmanParams"]

ControlT = TypeVar("ControlT")


class ExtendedKalmanParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="extended_kalman"
):
    """How often a reading is made linear, and which rows of the state are angles."""

    # 1 is the plain filter; more are Gauss-Newton steps towards the most probable state (Bell and Cathey, 1993).
    iterations: Count = 1
    angles: tuple[Annotated[int, Meta(ge=0)], ...] = (2,)


class ExtendedKalman(Generic[ControlT]):
    """A Gaussian motion, and a Gaussian measurement for each type of reading. The belief goes in and comes out."""

    def __init__(
        self,
        motion: GaussianMotion[ControlT],
        measurements: Mapping[type, GaussianMeasurement[Any]],
        params: ExtendedKalmanParams | None = None,
    ) -> None:
        self.motion = motion
        self.measurements = dict(measurements)
        self.params = validated(params or ExtendedKalmanParams())
        self._angles = np.array(self.params.angles, dtype=np.int64)

    def predict(self, belief: Gaussian, control: ControlT) -> Gaussian:
        """Return the belief after the control: mean f(x, u), covariance F P F^T + Q.

        Raises ValueError when that is not finite.
        """
        state = belief.mean[:, None]
        mean = _float64(self.motion.expected(state, control))[:, 0]
        transition = _float64(self.motion.jacobian(state, control))[:, :, 0]
        process = _float64(self.motion.covariance(state, control))[:, :, 0]
        after, finite = kalman.predicted(belief, mean, transition, process, self._angles)
        if not finite:
            raise kalman.not_finite(after)
        return after

    def update(self, belief: Gaussian, reading: object, gate: float | None = None) -> tuple[Gaussian, Innovation]:
        """Return the belief given the reading, and the innovation at the belief as it was.

        The belief stays as it was when the measurement model admits nothing, when innovation or Jacobian are not
        finite, or when the innovation's squared Mahalanobis distance exceeds ``gate``. Raises KeyError for a type of
        reading that has no model, SingularMatrixError when the innovation covariance is singular.
        """
        model = self.measurements[type(reading)]
        reading = kalman.admitted(model, belief, reading)
        if reading is None:
            return belief, kalman.NOTHING_ADMITTED
        noise = _float64(model.noise(reading))
        vector, observation = _linearized(model, belief.mean, reading)
        spread = kalman.expected_spread(belief.covariance, observation, noise)
        innovation = kalman.judged(vector, spread, gate)
        if not innovation.used:
            return belief, innovation
        after = kalman.corrected(belief, vector, observation, noise, self._angles)
        for _ in range(self.params.iterations - 1):
            vector, observation = _linearized(model, after.mean, reading)
            way_back = kalman.wrap_rows(belief.mean - after.mean, self.params.angles)
            vector = vector - product(observation, way_back)
            after = kalman.corrected(belief, vector, observation, noise, self._angles)
        if not np.isfinite(after.mean).all():
            return belief, innovation._replace(used=False)
        if not np.isfinite(after.covariance).all():
            raise kalman.not_finite(after)
        return after, innovation


def _linearized(model: GaussianMeasurement[Any], mean: FloatArray, reading: Any) -> tuple[FloatArray, FloatArray]:
    """Return the innovation (M,) and the Jacobian H (M, D) at a state."""
    state = mean[:, None]
    return _float64(model.innovation(state, reading))[:, 0], _float64(model.jacobian(state, reading))[:, :, 0]


def _float64(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
