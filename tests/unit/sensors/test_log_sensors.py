"""Log sensors: what passes, what is dropped, what is refused, and that it is counted."""

import math

import msgspec
import numpy as np
import pytest
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    InitialPose,
    LandmarkReading,
    LandmarkReadings,
    LaserScan,
    Message,
    Odometry,
    OdometryPose,
    Scanner,
    planar_pose,
    timestamp,
)
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.schema import Scenario
from dynpf_services.sensors.log import LogSensors
from dynpf_systems.rooms.localization.readings import reading_of

from dynpf.measurement import RangeBearingReadings

TOPICS = {
    InitialPose: "log/initial_pose",
    Odometry: "log/odometry",
    OdometryPose: "log/odometry_pose",
    LandmarkReadings: "log/landmarks",
    LaserScan: "log/scan",
    Scanner: "log/scanner",
}


def sensors() -> LogSensors:
    landmarks = (Landmark(id=6, x=0.0, y=0.0), Landmark(id=7, x=1.0, y=0.0))
    return LogSensors(Context(Scenario(title="A log", facts={"landmarks": landmarks}), "sensors"))


def step(*messages: Message) -> Step:
    return Step(0, 0, 0, tuple(Received(TOPICS[type(m)], "log", "import", i, 0, m) for i, m in enumerate(messages)))


def reading(landmark: int, distance: float = 1.0, bearing: float = 0.1) -> LandmarkReading:
    return LandmarkReading(landmark=landmark, range=distance, bearing=bearing)


def scan(*ranges: float) -> LaserScan:
    return LaserScan(
        timestamp=timestamp(0),
        frame_id="robot",
        pose=planar_pose(0, 0, 0),
        start_angle=-1.0,
        end_angle=1.0,
        ranges=ranges,
    )


def test_good_records_pass_unchanged_and_in_order() -> None:
    messages = (
        Odometry(v=0.1, w=-0.2),
        LandmarkReadings(readings=(reading(6), reading(7))),
        Scanner(range_min=0.1, range_max=8.0),
        scan(1.0, 2.0),
        Odometry(v=0, w=0),
        OdometryPose(x=1.0, y=2.0, theta=3.0),
    )
    result = sensors().step(step(*messages))
    assert [output.topic for output in result.outputs] == [
        "sensors/odometry",
        "sensors/landmarks",
        "sensors/scanner",
        "sensors/scan",
        "sensors/odometry",
        "sensors/odometry_pose",
    ]
    assert tuple(output.message for output in result.outputs) == messages


def test_readings_of_what_is_not_on_the_map_are_dropped_and_counted() -> None:
    node = sensors()
    (output,) = node.step(step(LandmarkReadings(readings=(reading(3), reading(7), reading(99))))).outputs
    assert output.message == LandmarkReadings(readings=(reading(7),))
    assert node.step(step(LandmarkReadings(readings=(reading(3),)))).outputs == ()
    assert node.freeze() == {"left_out": {"landmarks": {"not on the map": 3}}}


def test_a_landmark_that_moves_is_not_on_the_map_and_passes_with_its_place() -> None:
    moving = LandmarkReading(landmark=3, range=1.0, bearing=0.1, x=2.0, y=-1.0)
    message = LandmarkReadings(readings=(moving, reading(6)))
    (output,) = sensors().step(step(message)).outputs
    assert isinstance(output.message, LandmarkReadings)
    assert output.message.readings[0] == moving
    taken = reading_of(output.message, RangeBearingReadings)
    assert taken.places[:, 0].tolist() == [2.0, -1.0]
    assert np.isnan(taken.places[:, 1]).all()
    assert reading_of(LandmarkReadings(readings=(reading(6),)), RangeBearingReadings).places is None


@pytest.mark.parametrize(
    ("sensor", "bad"),
    [
        ("odometry", Odometry(v=math.nan, w=0.0)),
        ("odometry", Odometry(v=0.0, w=math.inf)),
        ("odometry_pose", OdometryPose(x=0.0, y=math.nan, theta=0.0)),
        ("scanner", Scanner(range_max=math.inf)),
        ("scanner", Scanner(range_min=2.0, range_max=1.0)),
        ("scan", scan()),
        ("scan", scan(1.0, math.nan)),
        ("scan", scan(1.0, -0.1)),
        ("landmarks", LandmarkReadings(readings=(reading(6, distance=-1.0),))),
        ("landmarks", LandmarkReadings(readings=(reading(6, distance=math.inf),))),
        ("landmarks", LandmarkReadings(readings=(reading(6, bearing=math.nan),))),
    ],
)
def test_what_no_sensor_could_have_read_is_refused_and_counted(sensor: str, bad: Message) -> None:
    node = sensors()
    assert node.step(step(bad)).outputs == ()
    assert node.freeze() == {"left_out": {sensor: {"refused": 1}}}


def test_bearings_are_brought_within_half_a_turn() -> None:
    (output,) = sensors().step(step(LandmarkReadings(readings=(reading(6, bearing=4.0),)))).outputs
    assert isinstance(output.message, LandmarkReadings)
    assert output.message.readings[0].bearing == pytest.approx(4.0 - math.tau)


def test_counts_survive_freezing() -> None:
    node, fresh = sensors(), sensors()
    node.step(step(LandmarkReadings(readings=(reading(3),)), Odometry(v=math.nan, w=0.0)))
    fresh.thaw(decode_state(encode_state(node.freeze())))
    left_out = {"landmarks": {"not on the map": 1}, "odometry": {"refused": 1}}
    assert fresh.freeze() == node.freeze() == {"left_out": left_out}


def test_a_told_pose_passes_if_its_covariance_is_one() -> None:
    node, certain = sensors(), InitialPose(x=1.0, y=2.0, theta=0.5, covariance=(0.0,) * 9)
    likely = msgspec.structs.replace(certain, covariance=(0.25, 0.1, 0.0, 0.1, 0.25, 0.0, 0.0, 0.0, 0.07))
    skew = msgspec.structs.replace(certain, covariance=(0.25, 0.1, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.07))
    negative = msgspec.structs.replace(certain, covariance=(0.25, 0.5, 0.0, 0.5, 0.25, 0.0, 0.0, 0.0, 0.07))
    passed = [output.message for output in node.step(step(certain, likely, skew, negative)).outputs]
    assert passed == [certain, likely]
    assert node.freeze()["left_out"] == {"initial_pose": {"refused": 2}}
