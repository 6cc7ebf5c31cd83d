"""The localization node: its state machine on a made-up drive, and its accuracy on a minute of a real one."""

import math
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
import pytest
from dynpf_protocol.codec import encode
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    Estimate,
    InitialPose,
    LandmarkReading,
    LandmarkReadings,
    Message,
    Odometry,
    OdometryPose,
    PoseInFrame,
    PosesInFrame,
    heading,
)
from dynpf_runtime.node import Output, Received, Step, decode_state, encode_state
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.estimator import LocalizationEstimator
from dynpf_systems.rooms.maps import Maps

from dynpf.filters.start import Box, FromReadingsStart, KnownStart, UniformStart
from dynpf.maps.landmarks import LandmarkMap
from dynpf.metrics.trajectory import Trajectory, TrajectoryScore, pose_errors, score, thin
from dynpf.motion import ArcsParams, CalibrationParams
from dynpf.motion.odometry import OdometryParams

DATA = Path(__file__).parents[3] / "../shared/data/mrclam/ds1_seed_60s"
LANDMARKS = (Landmark(id=6, x=3.0, y=1.0), Landmark(id=7, x=-1.0, y=2.0), Landmark(id=8, x=0.5, y=-2.0))
SECOND = 10**9
M = TypeVar("M", bound=Message)
NOISELESS = ArcsParams(
    along_variance_per_m=0.0, across_variance_per_m=0.0, turn_variance_per_rad=0.0, turn_variance_per_m=0.0
)


def received(stamp_s: float, message: Message) -> Received:
    topic = "sensors/odometry" if isinstance(message, Odometry) else "sensors/landmarks"
    return Received(topic, "sensors", "boot", 0, round(stamp_s * SECOND), message)


def seen_from(x: float, y: float, theta: float) -> LandmarkReadings:
    return LandmarkReadings(
        readings=tuple(
            LandmarkReading(
                landmark=mark.id,
                range=math.hypot(mark.x - x, mark.y - y),
                bearing=math.remainder(math.atan2(mark.y - y, mark.x - x) - theta, math.tau),
            )
            for mark in LANDMARKS
        )
    )


def circle(t: float) -> tuple[float, float, float]:
    return math.sin(0.5 * t), 1.0 - math.cos(0.5 * t), 0.5 * t


def drive(duration_s: float = 4.0) -> list[Step]:
    """A circle of radius 1 at 0.5 m/s: odometry ten times a second, readings after every fifth."""
    steps = []
    for k in range(round(duration_s * 10)):
        inputs = [received(0.1 * k, Odometry(v=0.5, w=0.5))]
        if k % 5 == 4:
            inputs.append(received(0.1 * k, seen_from(*circle(0.1 * k))))
        steps.append(Step(k, k, round(0.1 * k * SECOND), tuple(inputs)))
    return steps


def node(seed: int = 1, **settings: object) -> LocalizationEstimator:
    config = msgspec.structs.replace(LocalizationConfig(n=300, calibration=CalibrationParams()), **settings)
    return built(config, seed, LANDMARKS)


def built(config: LocalizationConfig, seed: int, landmarks: tuple[Landmark, ...]) -> LocalizationEstimator:
    maps = Maps(landmarks=LandmarkMap((mark.id, mark.x, mark.y) for mark in landmarks))
    return LocalizationEstimator(config=config, seed=seed, landmarks=landmarks, maps=maps, classes={})


def payloads(outputs: tuple[Output, ...]) -> list[tuple[str, bytes]]:
    return [(output.topic, encode(output.topic, output.message)) for output in outputs]


def of_type(outputs: tuple[Output, ...], kind: type[M]) -> list[M]:
    return [output.message for output in outputs if isinstance(output.message, kind)]


def test_the_estimate_follows_the_robot_and_its_covariance_covers_the_error() -> None:
    estimator = node(n=1000)
    for step in drive(10.0):
        outputs = estimator.step(step).outputs
    (estimate,) = of_type(outputs, Estimate)
    x, y, theta = circle(9.9)
    covariance = np.array(estimate.covariance).reshape(3, 3)
    error = np.array([estimate.x - x, estimate.y - y, math.remainder(estimate.theta - theta, math.tau)])
    assert np.hypot(*error[:2]) < 0.1
    assert error @ np.linalg.solve(covariance, error) < 16.3  # 99.9 % of chi-square with 3 degrees of freedom
    assert 1.0 <= estimate.n_eff <= 1000.0 + 1e-9


def test_a_thawed_node_continues_as_the_frozen_one_would_have() -> None:
    steps = drive()
    original = node(odometry_delay=0.25)
    for step in steps[:20]:
        original.step(step)
    frozen = encode_state(original.freeze())
    resumed = node(odometry_delay=0.25)
    resumed.thaw(decode_state(frozen))
    fresh = node(odometry_delay=0.25)
    expected = [payloads(original.step(step).outputs) for step in steps[20:]]
    assert [payloads(resumed.step(step).outputs) for step in steps[20:]] == expected
    assert encode_state(resumed.freeze()) == encode_state(original.freeze())
    assert [payloads(fresh.step(step).outputs) for step in steps[20:]] != expected


def test_a_node_with_other_settings_adopts_a_state_if_its_model_is_the_same() -> None:
    before, told = node(n=40), drive()
    for step in told[:20]:
        before.step(step)
    state = decode_state(encode_state(before.freeze()))
    same, more = node(n=40), node(n=200)
    same.adopt(state)
    assert encode_state(same.freeze()) == encode_state(state)
    more.adopt(decode_state(encode_state(state)))
    belief = more.freeze()["belief"]
    assert belief["particles"].shape == (state["belief"]["particles"].shape[0], 200)
    assert {*map(tuple, belief["particles"].T)} <= {*map(tuple, state["belief"]["particles"].T)}
    assert belief["n_eff"] == 200
    more.step(told[20])
    plain = node(n=40, calibration=None)
    with pytest.raises(ValueError, match="numbers a state; expected 3"):
        plain.adopt(decode_state(encode_state(state)))
    state["belief"]["weights"] = state["belief"]["weights"][1:]
    with pytest.raises(ValueError, match="particles, weights and their logarithms have the shapes"):
        same.thaw(state)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not() -> None:
    def run(seed: int) -> list[list[tuple[str, bytes]]]:
        estimator = node(seed)
        return [payloads(estimator.step(step).outputs) for step in drive(2.0)]

    assert run(5) == run(5)
    assert run(5) != run(6)


def test_a_step_without_inputs_says_nothing_and_changes_nothing() -> None:
    estimator = node()
    estimator.step(drive()[0])
    before = encode_state(estimator.freeze())
    assert estimator.step(Step(1, 1, 5 * SECOND, ())).outputs == ()
    assert encode_state(estimator.freeze()) == before


def test_particles_are_shown_five_times_a_second_and_two_hundred_at_most() -> None:
    estimator = node()
    shown = [cloud for step in drive(4.0) for cloud in of_type(estimator.step(step).outputs, PosesInFrame)]
    assert len(shown) == 20
    assert {len(cloud.poses) for cloud in shown} == {200}
    few = node(n=7)
    (cloud,) = of_type(few.step(drive()[0]).outputs, PosesInFrame)
    assert len(cloud.poses) == 7


@pytest.mark.parametrize(("delay", "travelled"), [(0.0, 1.0), (0.4, 0.6), (2.0, 0.0)])
def test_odometry_takes_effect_after_its_delay(delay: float, travelled: float) -> None:
    estimator = node(odometry_delay=delay, motion=NOISELESS, calibration=None)
    estimator.step(Step(0, 0, 0, (received(0.0, Odometry(v=1.0, w=0.0)),)))
    outputs = estimator.step(Step(1, 1, SECOND, (received(1.0, Odometry(v=0.0, w=0.0)),))).outputs
    reckoned = next(output.message for output in outputs if output.topic == "estimator/dead_reckoning")
    assert isinstance(reckoned, PoseInFrame)
    assert reckoned.pose.position.x == pytest.approx(travelled)
    estimator_spread = np.ptp(estimator.freeze()["belief"]["particles"][0])
    assert estimator_spread > 0.0


def test_dead_reckoning_takes_the_exact_arcs() -> None:
    estimator = node()
    for step in drive(4.0):
        outputs = estimator.step(step).outputs
    reckoned = next(output.message for output in outputs if output.topic == "estimator/dead_reckoning")
    assert isinstance(reckoned, PoseInFrame)
    pose = (reckoned.pose.position.x, reckoned.pose.position.y, heading(reckoned.pose.orientation))
    assert pose == pytest.approx(circle(3.9))


def test_late_readings_count_as_if_taken_now_and_overtaken_odometry_not_at_all() -> None:
    def after(inputs: tuple[Received, ...]) -> bytes:
        estimator = node(motion=NOISELESS)
        estimator.step(Step(0, 0, SECOND, (received(1.0, Odometry(v=0.0, w=0.0)),)))
        estimator.step(Step(1, 1, SECOND, inputs))
        estimator.step(Step(2, 2, 2 * SECOND, (received(2.0, Odometry(v=0.0, w=0.0)),)))
        return encode_state(estimator.freeze())

    late, now = received(0.2, seen_from(0.0, 0.0, 0.0)), received(1.0, seen_from(0.0, 0.0, 0.0))
    overtaken = received(0.5, Odometry(v=1.0, w=0.0))
    assert after((late,)) == after((now,)) == after((overtaken, now))
    assert after((late,)) != after((overtaken,))


def test_an_unknown_landmark_is_reported_once_and_left_out() -> None:
    estimator = node()
    strange = LandmarkReadings(readings=(LandmarkReading(landmark=61, range=1.0, bearing=0.0),))
    first = estimator.step(Step(0, 0, 0, (received(0.0, strange),))).outputs
    again = estimator.step(Step(1, 1, 0, (received(0.0, strange),))).outputs
    assert [output.topic for output in first].count("log") == 1
    assert [output.topic for output in again].count("log") == 0
    assert estimator.freeze()["outcomes"] == {"used": 0, "refused": 2, "impossible": 0}


def test_the_configuration_names_value_and_range() -> None:
    good = {"kind": "localization", "n": 50, "measurement": [{"kind": "range_bearing", "gate": 9.0}]}
    assert msgspec.convert(good, LocalizationConfig).measurement[0].gate == 9.0
    for bad, words in (
        ({"n": 0}, "int` >= 1 - at `$.n`"),
        ({"motion": {"kind": "arcs", "along_variance_per_m": -0.1}}, ">= 0.0 - at `$.motion.along_variance_per_m`"),
        ({"resampling": {"kind": "systematic", "threshold": 1.5}}, "<= 1.0 - at `$.resampling.threshold`"),
        ({"measurement": [{"kind": "beem"}]}, "beem"),
        ({"odometry_dely": 0.1}, "odometry_dely"),
    ):
        with pytest.raises(msgspec.ValidationError) as refusal:
            msgspec.convert({"kind": "localization", **bad}, LocalizationConfig)
        assert words in str(refusal.value)


# --- a minute of a real log ----------------------------------------------------------------------------------------


def read(name: str) -> np.ndarray:
    return np.loadtxt(DATA / f"ds1_{name}.dat", comments="#")


def play(with_readings: bool) -> tuple[TrajectoryScore, TrajectoryScore]:
    """Return the scores of the estimate and of dead reckoning, both from the true start."""
    subjects = {barcode: subject for subject, barcode in read("Barcodes").astype(int).tolist()}
    landmarks = tuple(Landmark(id=int(row[0]), x=row[1], y=row[2]) for row in read("Landmark_Groundtruth"))
    known = {mark.id for mark in landmarks}
    truth_rows, odometry = read("Groundtruth"), read("Odometry")
    origin = truth_rows[0, 0]
    truth = Trajectory(truth_rows[:, 0] - origin, truth_rows[:, 1:].T)

    records: list[tuple[float, Message]] = [(row[0] - origin, Odometry(v=row[1], w=row[2])) for row in odometry]
    for time, barcode, distance, bearing in read("Measurement"):
        landmark = subjects.get(int(barcode), -1)
        if with_readings and landmark in known:
            reading = LandmarkReading(landmark=landmark, range=distance, bearing=bearing)
            records.append((time - origin, LandmarkReadings(readings=(reading,))))
    records.sort(key=lambda record: record[0])

    first = Trajectory(np.array([records[0][0]]), np.zeros((3, 1)))
    x, y, theta = (-pose_errors(first, truth).errors[:, 0]).tolist()
    config = LocalizationConfig(odometry_delay=0.15, calibration=CalibrationParams())
    config = msgspec.structs.replace(config, start=msgspec.structs.replace(config.start, x=x, y=y, theta=theta))
    estimator = built(config, 1, landmarks)
    stamps, estimates, reckonings = [], [], []
    for number, (time, message) in enumerate(records):
        one = received(time, message)
        outputs = estimator.step(Step(number, number, one.stamp_ns, (one,))).outputs
        (estimate,) = of_type(outputs, Estimate)
        reckoned = next(output.message for output in outputs if output.topic == "estimator/dead_reckoning")
        assert isinstance(reckoned, PoseInFrame)
        stamps.append(time)
        estimates.append((estimate.x, estimate.y, estimate.theta))
        position = reckoned.pose.position
        reckonings.append((position.x, position.y, heading(reckoned.pose.orientation)))
    kept = thin(np.array(stamps))
    filtered, raw = (
        Trajectory(np.array(stamps)[kept], np.array(poses).T[:, kept]) for poses in (estimates, reckonings)
    )
    return score(filtered, truth), score(raw, truth)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the real log is not at {DATA}")
def test_a_real_minute_is_tracked_within_15_cm_and_withholding_the_readings_loses_it() -> None:
    estimate, reckoning = play(with_readings=True)
    assert estimate.scored > 400
    assert estimate.position_rmse_m < 0.15
    blind, blind_reckoning = play(with_readings=False)
    assert blind.position_rmse_m > 3 * estimate.position_rmse_m
    assert blind_reckoning.position_rmse_m == pytest.approx(reckoning.position_rmse_m, abs=0.02)
    assert reckoning.position_rmse_m > 3 * estimate.position_rmse_m


POSES = ((0.0, (0.0, 0.0, 0.0)), (1.0, (1.0, 0.0, 1.0)), (0.5, (1.0, 1.0, 2.0)), (2.0, (-1.0, 0.5, -3.0)))
START = (3.0, -1.0, 0.5)


def by_poses(kind: object, count: int = len(POSES)) -> tuple[LocalizationEstimator, list[Output]]:
    """Follow odometry poses, the third of which comes with a stamp that has passed."""
    start = KnownStart(x=START[0], y=START[1], theta=START[2], sigma_position=0.0, sigma_heading=0.0)
    estimator = node(n=20, start=start, calibration=None, motion=kind)
    outputs: list[Output] = []
    for k, (stamp_s, (x, y, theta)) in enumerate(POSES[:count]):
        pose = Received(
            "sensors/odometry_pose", "sensors", "b", k, round(stamp_s * SECOND), OdometryPose(x=x, y=y, theta=theta)
        )
        outputs += estimator.step(Step(k, k, pose.stamp_ns, (pose,))).outputs
    return estimator, outputs


def moved(last: tuple[float, float, float]) -> complex:
    """Where odometry's last pose lies, seen from the start: odometry began at its origin."""
    return complex(START[0], START[1]) + complex(last[0], last[1]) * complex(math.cos(START[2]), math.sin(START[2]))


def test_odometry_that_comes_as_poses_moves_the_belief_by_their_differences_whatever_their_stamps() -> None:
    noiseless = OdometryParams(alpha_1=0.0, alpha_2=0.0, alpha_3=0.0, alpha_4=0.0)
    _, outputs = by_poses(noiseless)
    states = [one.message for one in outputs if isinstance(one.message, Estimate)]
    assert len(states) == len(POSES)
    for state, (_, pose) in zip(states, POSES, strict=True):
        assert complex(state.x, state.y) == pytest.approx(moved(pose), abs=1e-5)
        assert math.remainder(state.theta - START[2] - pose[2], math.tau) == pytest.approx(0.0, abs=1e-5)
    reckoned = [one.message for one in outputs if one.topic == "estimator/dead_reckoning"]
    assert isinstance(reckoned[-1], PoseInFrame)
    last = reckoned[-1].pose.position
    assert complex(last.x, last.y) == pytest.approx(moved(POSES[-1][1]), abs=1e-9)


def test_a_model_of_twists_gets_the_arc_of_the_same_chord_and_turn() -> None:
    _, outputs = by_poses(NOISELESS, 2)
    state = [one.message for one in outputs if isinstance(one.message, Estimate)][-1]
    assert math.hypot(state.x - START[0], state.y - START[1]) == pytest.approx(1.0, abs=1e-5)
    assert state.theta - START[2] == pytest.approx(1.0, abs=1e-5)


def test_the_last_pose_of_odometry_is_part_of_the_state() -> None:
    first, _ = by_poses(OdometryParams())
    second, _ = by_poses(OdometryParams(), 1)
    second.thaw(decode_state(encode_state(first.freeze())))
    pose = Received("sensors/odometry_pose", "sensors", "b", 9, 3 * SECOND, OdometryPose(x=-1.0, y=0.7, theta=-3.1))
    step = Step(9, 9, pose.stamp_ns, (pose,))
    assert first.step(step) == second.step(step)
    assert "odometry_pose" not in node().freeze()


@pytest.mark.parametrize(
    ("least", "used"),
    [
        ({}, 8),
        # Two seconds are a metre and a radian: every fourth of the readings, which come twice a second.
        ({"min_travel": 0.99, "min_turn": 9.0}, 2),
        ({"min_travel": 9.0, "min_turn": 0.99}, 2),
    ],
)
def test_readings_are_taken_in_only_after_enough_movement(least: dict[str, float], used: int) -> None:
    whole, thawed = node(1, **least), node(1, **least)
    for step in drive():
        whole.step(step)
        thawed.thaw(decode_state(encode_state(whole.freeze())))
        assert encode_state(thawed.freeze()) == encode_state(whole.freeze())
    assert whole.freeze()["outcomes"]["used"] == used


def told_pose(stamp_s: float, x: float, y: float, theta: float) -> Received:
    covariance = (0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.01)
    message = InitialPose(x=x, y=y, theta=theta, covariance=covariance)
    return Received("sensors/initial_pose", "sensors", "boot", 0, round(stamp_s * SECOND), message)


def estimates(outputs: list[Output]) -> Estimate:
    return next(output.message for output in outputs if isinstance(output.message, Estimate))


def test_the_filter_begins_anew_where_it_is_told_to_with_that_covariance_and_goes_on_from_there() -> None:
    localization, *steps = node(n=20_000), *drive()
    for step in steps:
        localization.step(step)
    told = Step(40, 40, 4 * SECOND, (told_pose(4.0, 2.0, -1.0, 3.0),))
    found = estimates(list(localization.step(told).outputs))
    assert (found.x, found.y, found.theta) == pytest.approx((2.0, -1.0, 3.0), abs=0.01)
    assert found.covariance == pytest.approx((0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.01), abs=0.002)
    other = node(n=20_000)
    other.thaw(decode_state(encode_state(localization.freeze())))
    here = seen_from(2.1, -1.1, 3.05)  # at rest since, which counts the first time
    seen = Step(41, 41, 4 * SECOND + 1000, (received(4.000001, here),))
    after = estimates(list(localization.step(seen).outputs))
    assert estimates(list(other.step(seen).outputs)) == after
    assert math.hypot(after.x - 2.1, after.y + 1.1) < math.hypot(found.x - 2.1, found.y + 1.1)


def test_a_pose_that_is_told_is_enough_to_begin_with() -> None:
    anywhere = UniformStart(box=Box(x_min=-3.0, x_max=3.0, y_min=-3.0, y_max=3.0))
    localization = node(start=FromReadingsStart(base=anywhere))
    found = estimates(list(localization.step(Step(0, 0, 0, (told_pose(0.0, 1.0, 1.0, 0.0),))).outputs))
    assert (found.x, found.y) == pytest.approx((1.0, 1.0), abs=0.1)
