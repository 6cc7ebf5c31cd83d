"""A live ROS 2 robot over Zenoh: its run is recorded with its losses, replays exactly, and the robot gets the pose."""

import json
import math
from contextlib import ExitStack
from itertools import pairwise

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.types import RosTypes
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import HostEvent, InitialPose, OdometryPose
from dynpf_runtime.bus.processes import free_port

from tests.integration.processes import until
from tests.integration.robots import POSE, SCAN, live_robot, robot_at, router, router_process

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


def started(dynpf, endpoint, path, *words):
    """Start a bridge that takes in every scan."""
    common = ["--connect", endpoint, "-o", path, "--no-page", "--json"]
    common += ["--set", "estimator.min_travel=0.0", "--set", KNOWN]
    return dynpf("bridge", "ros2", "laser-log", *common, *words)


def same_again(path, here):
    """Return the messages of a recording, which is whole and replays exactly."""
    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.err
    assert json.loads(replayed.out)["same"]
    recording = read_recording(path)
    assert recording.end is not None
    assert recording.end.complete
    return list(recording.messages())


def answered(run, robot, enough, what):
    """Wait until poses have come back of which ``enough`` is true."""
    until(lambda: run.popen.poll() is not None or any(enough(*pose) for pose in robot.poses()), what)
    assert run.popen.poll() is None, run.stderr


def test_a_pose_that_is_told_is_taken_and_a_simulators_time_may_begin_again(tmp_path, dynpf, here, types):
    path = tmp_path / "live.mcap"
    with live_robot(types, simulated=True, lost_every=10**9) as (endpoint, robot):
        run = started(dynpf, endpoint, path)
        answered(run, robot, lambda *_: True, "a first pose")
        robot.tell(-1.2, 1.3)
        answered(run, robot, lambda _, x, y: math.dist((x, y), (-1.2, 1.3)) < 0.1, "the pose that was told")
        before = len(robot.poses())
        latest_s = max(stamp for stamp, _, _ in robot.poses())
        robot.reset()
        until(lambda: any(stamp < latest_s - 3.0 for stamp, _, _ in robot.poses()[before:]), "a pose of the new time")
        run.interrupt()
        assert run.wait() == 0, run.stderr
    assert "the robot's clock has jumped" in run.stderr
    messages = same_again(path, here)
    (told,) = [decode(one.topic, one.payload) for one in messages if one.topic == "sensors/initial_pose"]
    assert isinstance(told, InitialPose)
    assert (told.x, told.y) == pytest.approx((-1.2, 1.3))
    stamps = [one.stamp_ns for one in messages if one.topic == "log/scan"]
    assert max(after - before for before, after in pairwise(stamps)) < 2 * 10**9  # the run's time knows no jump


def test_each_of_several_robots_has_its_own_filter_and_one_turns_as_its_gyro_does(tmp_path, dynpf, here, types):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    places, gyros = {"/bot1": (0.3, 0.1), "/bot2": (-0.9, 0.6)}, {"/bot1": None, "/bot2": 0.05}
    with ExitStack() as stack:
        stack.enter_context(router(endpoint))
        robots = {
            name: stack.enter_context(robot_at(endpoint, types, namespace=name, place=place, gyro=gyros[name]))
            for name, place in places.items()
        }
        runs = {}
        for name, (x, y) in places.items():
            start = f'estimator.start={{kind="known", x={x}, y={y}, sigma_position=0.1, sigma_heading=0.05}}'
            words = ["--namespace", name, "--set", start]
            words += [] if gyros[name] is None else ["--imu", f"{name}/imu"]
            runs[name] = started(dynpf, endpoint, tmp_path / f"{name[1:]}.mcap", *words)
        until(lambda: all(len(robot.poses()) >= 10 for robot in robots.values()), "poses of both")
        for run in runs.values():
            run.interrupt()
        for name, run in runs.items():
            assert run.wait() == 0, run.stderr
            assert f"hears {name}/scan, odometry {name}/odom" in run.stderr
    for name, robot in robots.items():
        assert robot.poses()[-1][1:] == pytest.approx(places[name], abs=0.3)
        messages = same_again(tmp_path / f"{name[1:]}.mcap", here)
        odometry = [one for one in messages if one.topic == "log/odometry_pose"]
        first, last = (decode(one.topic, one.payload) for one in (odometry[0], odometry[-1]))
        assert isinstance(first, OdometryPose)
        assert isinstance(last, OdometryPose)
        seconds = (odometry[-1].stamp_ns - odometry[0].stamp_ns) * 1e-9
        assert (last.theta - first.theta) / seconds == pytest.approx(gyros[name] or 0.0, abs=0.01)


def test_a_robots_router_that_restarts_costs_what_it_did_not_pass_on(tmp_path, dynpf, here, types):
    path, port = tmp_path / "live.mcap", free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        first = stack.enter_context(router_process(endpoint))
        robot = stack.enter_context(robot_at(endpoint, types, lost_every=10**9))
        run = started(dynpf, endpoint, path)
        answered(run, robot, lambda *_: True, "a first pose")
        first.kill()
        first.wait()
        before = len(robot.poses())
        stack.enter_context(router_process(endpoint))
        until(lambda: len(robot.poses()) > before + 10, "poses by the new router")
        kinds = {(entity.kind, entity.published.topic) for entity in robot.entities() if entity.published is not None}
        assert {("MP", "/amcl_pose"), ("MS", "/scan"), ("MP", "/scan")} <= kinds
        run.interrupt()
        assert run.wait() == 0, run.stderr
    gaps = [decode(one.topic, one.payload) for one in same_again(path, here) if one.topic == "event/sensors"]
    assert {gap.topic for gap in gaps if isinstance(gap, HostEvent)} == {"log/scan", "log/odometry_pose"}


def test_a_robot_behind_the_bridge_from_dds_is_localized_though_its_messages_have_no_numbers(
    tmp_path, dynpf, here, types
):
    path = tmp_path / "live.mcap"
    with live_robot(types, wire="ros2dds") as (endpoint, robot):
        run = started(dynpf, endpoint, path, "--format", "ros2dds")
        answered(run, robot, lambda *_: True, "a first pose")
        robot.tell(-1.2, 1.3)
        answered(run, robot, lambda _, x, y: math.dist((x, y), (-1.2, 1.3)) < 0.1, "the pose that was told")
        topics = {(one.kind, one.published.topic, one.published.type) for one in robot.entities() if one.published}
        assert {("MP", "/amcl_pose", POSE), ("MS", "/scan", SCAN)} <= topics
        run.interrupt()
        assert run.wait() == 0, run.stderr
    messages = same_again(path, here)
    assert any(attachment.name == "files/map.yaml" for attachment in read_recording(path).attachments)
    assert not [one for one in messages if one.topic == "event/sensors"]  # the robot skips numbers that nobody sees


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([], "name the robot's router"),
        (["--dds", "--connect", "tcp/127.0.0.1:1"], "name the robot's router"),
        (["--dds", "--format", "ros2dds"], "--format ros2dds: is for a robot behind a router"),
        (["--connect", "tcp/127.0.0.1:1", "--format", "ros2dds", "--domain", "3"], "--domain 3: zenoh-bridge-ros2dds"),
    ],
)
def test_ways_to_a_robot_that_do_not_go_together_are_refused(words, reason, here):
    told = here("bridge", "ros2", "laser-log", *words)
    assert told.code == 2
    assert reason in told.err


def test_no_router_of_a_robot_is_told_with_what_starts_one(tmp_path, dynpf):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = dynpf("bridge", "ros2", "laser-log", "--connect", endpoint, "-o", str(tmp_path / "live.mcap"))
    assert run.wait() == 2
    assert f"--connect {endpoint}: no Zenoh router of a robot" in run.stderr
