"""A live ROS 2 robot over Zenoh: its run is recorded with its losses, replays exactly, and the robot gets the pose."""

import json

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.types import RosTypes
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import HostEvent
from dynpf_runtime.bus.processes import free_port

from tests.integration.robots import live_robot

TICKS = 40
KNOWN = 'estimator.start={kind="known", x=0.3, y=0.1, sigma_position=0.1, sigma_heading=0.05}'


@pytest.fixture(scope="module")
def types():
    return RosTypes()


def test_a_live_run_is_recorded_with_its_losses_replays_exactly_and_is_answered(tmp_path, dynpf, here, types):
    path = tmp_path / "live.mcap"
    with live_robot(types) as (endpoint, robot):
        words = ["bridge", "ros2", "laser-log", "--connect", endpoint, "-o", str(path), "--no-page", "--json"]
        words += ["--set", f"max_ticks={TICKS}", "--set", "estimator.min_travel=0.0", "--set", KNOWN]
        run = dynpf(*words)
        assert run.wait() == 0, run.stderr
        heard = robot.heard
    recording = read_recording(path)
    assert json.loads(run.stdout)["complete"]
    assert any(attachment.name == "files/map.yaml" for attachment in recording.attachments)  # latched before we came
    gaps = [decode(one.topic, one.payload) for one in recording.messages() if one.topic == "event/sensors"]
    assert gaps
    assert all(isinstance(gap, HostEvent) and gap.topic == "log/scan" and gap.first == gap.last for gap in gaps)

    (kind, payload, _), *_ = heard["/amcl_pose"]
    assert kind == "geometry_msgs/msg/PoseWithCovarianceStamped"
    position = types.decode(kind, payload).pose.pose.position
    assert (position.x, position.y) == pytest.approx((0.3, 0.1), abs=0.3)
    numbers = [Attachment.decode(attached).sequence for _, _, attached in heard["/amcl_pose"]]
    assert numbers == list(range(1, len(numbers) + 1))
    assert {"/tf", "/particle_cloud", "/particlecloud", "/diagnostics"} <= heard.keys()

    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.err
    assert json.loads(replayed.out)["same"]


def test_no_router_of_a_robot_is_told_with_what_starts_one(tmp_path, dynpf):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = dynpf("bridge", "ros2", "laser-log", "--connect", endpoint, "-o", str(tmp_path / "live.mcap"))
    assert run.wait() == 2
    assert f"--connect {endpoint}: no Zenoh router of a robot" in run.stderr
