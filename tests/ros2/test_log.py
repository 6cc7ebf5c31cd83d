"""A real robot's log, played by another implementation of rmw_zenoh, is localized live, and the run replays exactly."""

import json
import math

import pytest
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.ros2.keys import LATCHED, Published
from dynpf_protocol.messages import RobotState
from dynpf_services.ros2.session import RobotSession

from tests.integration.processes import DATA, PATIENCE_S
from tests.ros2.robot_log import ODOMETRY, SCAN, room_of, write_log

CARMEN = DATA / "carmen" / "intel_30-150s.log"
MAP, POSE = "nav_msgs/msg/OccupancyGrid", "geometry_msgs/msg/PoseWithCovarianceStamped"
SECONDS, RATE = 30.0, 5.0
FIRST_S = 1_000_000.0


def test_a_log_played_by_the_sdk_is_localized_live_and_replays_the_same(tmp_path, dynpf, here, theirs, endpoint, types):
    if not CARMEN.is_file():
        pytest.skip(f"the logs are not in {DATA}")
    log, path = tmp_path / "log.jsonl", tmp_path / "live.mcap"
    room = room_of(drawn_map(lambda: import_carmen(CARMEN).records, 0.05, "map"), types)
    truth = [
        (one.stamp_ns, one.message) for one in import_carmen(CARMEN).records if isinstance(one.message, RobotState)
    ]
    sent = write_log(import_carmen(CARMEN).records, log, SECONDS)
    start = truth[0][1]
    with RobotSession.connect(endpoint, 0, "") as session:
        server = session.writer(Published("/map", MAP, types.hash(MAP)), LATCHED)
        server.put(room, 1)
        theirs.ask("advertise", name="/scan", kind=SCAN)
        theirs.ask("advertise", name="/odom", kind=ODOMETRY)
        theirs.ask("hear", name="/amcl_pose", kind=POSE)
        known = f'estimator.start={{kind="known", x={start.x}, y={start.y}, theta={start.theta}}}'
        words = [
            "bridge",
            "ros2",
            "laser-log",
            "--connect",
            endpoint,
            "--set",
            known,
            "-o",
            path,
            "--no-page",
            "--json",
        ]
        run = dynpf(*words)
        theirs.ask("play", path=str(log), first_s=FIRST_S, rate=RATE)
        assert theirs.ask("count", name="/amcl_pose", least=1, within_s=PATIENCE_S) >= 1, run.stderr
        theirs.ask("go")
        assert theirs.ask("count", name="played", least=1, within_s=PATIENCE_S) == 1
        (stood_s,) = theirs.ask("heard", name="played", least=1)
        run.interrupt()
        assert run.wait() == 0, run.stderr
    told = json.loads(run.stdout)
    assert told["complete"]
    assert told["gaps"] == 0

    messages = list(read_recording(path).messages())
    moved = [one for one in messages if one.stamp_ns >= (FIRST_S + stood_s) * 1e9 - 1]
    assert sum(one.topic == "log/scan" for one in moved) == sent["/scan"]
    assert sum(one.topic == "log/odometry_pose" for one in moved) >= sent["/odom"] - 1  # repeated odometry is none
    last = theirs.ask("heard", name="/amcl_pose", least=1)[-1]
    ended_s = last["header"]["stamp"]["sec"] + last["header"]["stamp"]["nanosec"] * 1e-9 - FIRST_S - stood_s
    nearest = min(truth, key=lambda one: abs((one[0] - truth[0][0]) * 1e-9 - ended_s))[1]
    position = last["pose"]["pose"]["position"]
    assert ended_s > SECONDS - 2.0
    assert math.dist((position["x"], position["y"]), (nearest.x, nearest.y)) < 0.5

    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.err
    assert json.loads(replayed.out)["same"]
