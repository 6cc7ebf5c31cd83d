"""Odometry's noise goes by the way that is made, not by how often and how shakily odometry tells of it."""

import math

import numpy as np
import pytest
from dynpf_protocol.messages import Estimate, OdometryPose
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_systems.rooms.localization.components import Moved
from dynpf_systems.rooms.localization.config import LocalizationConfig, StepParams
from dynpf_systems.rooms.localization.estimator import LocalizationEstimator
from dynpf_systems.rooms.localization.strides import Strides
from dynpf_systems.rooms.maps import Maps

from dynpf.filters.start import Box, KnownStart, UniformStart
from dynpf.maps.landmarks import LandmarkMap
from dynpf.motion.model import Displacement
from dynpf.motion.odometry import OdometryParams

FAR = (388_096.0, 3_948_996.0)
MARKS = [(1, 2.0, 0.5), (2, -1.0, 3.0)]


SQUARED = OdometryParams(alpha_1=0.2, alpha_2=0.2, alpha_3=0.2, alpha_4=0.05)
LINEAR = OdometryParams(growth="linear", alpha_1=0.02, alpha_2=0.01, alpha_3=0.01, alpha_4=0.005)


def estimator(
    step: StepParams | None, at: tuple[float, float] = (0.0, 0.0), motion: OdometryParams = LINEAR
) -> LocalizationEstimator:
    config = LocalizationConfig(
        n=2000,
        start=KnownStart(x=at[0], y=at[1], sigma_position=0.02, sigma_heading=0.01),
        motion=motion,
        odometry_step=step,
        restart=UniformStart(box=Box(x_min=at[0], x_max=at[0] + 1.0, y_min=at[1], y_max=at[1] + 1.0)),
    )
    maps = Maps(landmarks=LandmarkMap((number, x + at[0], y + at[1]) for number, x, y in MARKS))
    return LocalizationEstimator(config=config, seed=1, maps=maps, classes={})


def last(node: LocalizationEstimator, poses: list[tuple[float, float, float]]) -> Estimate:
    for k, (x, y, theta) in enumerate(poses):
        message = OdometryPose(x=x, y=y, theta=theta)
        received = Received("sensors/odometry_pose", "sensors", "b", k, k * 10**7, message)
        outputs = node.step(Step(k, k, received.stamp_ns, (received,))).outputs
    return next(one.message for one in outputs if isinstance(one.message, Estimate))


def straight(count: int, jitter_m: float = 0.0) -> list[tuple[float, float, float]]:
    sideways = jitter_m * np.random.default_rng(1).normal(size=count + 1)
    sideways[0] = sideways[-1] = 0.0
    return [(2.0 * k / count, float(sideways[k]), 0.0) for k in range(count + 1)]


def heading_sigma(poses: list[tuple[float, float, float]], node: LocalizationEstimator | None = None) -> float:
    return math.sqrt(last(node or estimator(StepParams()), poses).covariance[8])


def test_neither_rate_nor_jitter_of_odometry_adds_to_its_noise() -> None:
    plain = heading_sigma(straight(20))
    assert heading_sigma(straight(400)) == pytest.approx(plain, rel=0.08)
    assert heading_sigma(straight(400, jitter_m=0.005)) == pytest.approx(plain, rel=0.08)
    # The control: of each record by itself, squared, jitter is taken for turns, and a high rate for certainty.
    by_record = [estimator(None, motion=SQUARED) for _ in range(2)]
    assert heading_sigma(straight(400), by_record[0]) < 0.5 * plain
    assert heading_sigma(straight(400, jitter_m=0.005), by_record[1]) > 2.0 * plain


def test_between_strides_the_estimate_is_where_odometry_is() -> None:
    found = last(estimator(StepParams(travel=10.0, turn=10.0)), [(0.0, 0.0, 0.0), (0.5, 0.1, 0.2), (0.9, 0.3, 0.4)])
    assert (found.x, found.y, found.theta) == pytest.approx((0.9, 0.3, 0.4), abs=0.02)


def test_a_stride_is_the_net_displacement() -> None:
    strides = Strides(StepParams(travel=0.5, turn=0.5))
    strides.mark()
    there, back = Moved(Displacement(0.3, 0.0, 0.0), 0.1), Moved(Displacement(-0.3, 0.0, 0.0), 0.1)
    assert [strides.take(moved) for moved in (there, back, there)] == [None] * 3
    again = Strides(StepParams(travel=0.5, turn=0.5))
    again.thaw(decode_state(encode_state(strides.freeze())))
    made = again.take(there)
    assert made is not None
    assert made.displacement == pytest.approx((0.6, 0.0, 0.0))
    assert made.duration == pytest.approx(0.4)
    assert again.travelled == pytest.approx((0.6, 0.0))
    assert again.rest() is None


def test_far_from_zero_the_estimate_is_that_of_the_same_run_near_zero() -> None:
    near, far = last(estimator(StepParams()), straight(40)), last(estimator(StepParams(), FAR), straight(40))
    assert (far.x - FAR[0], far.y - FAR[1], far.theta) == pytest.approx((near.x, near.y, near.theta), abs=1e-5)
    assert far.covariance == pytest.approx(near.covariance, abs=1e-6)
