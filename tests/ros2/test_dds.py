"""A node of ROS 2 itself, on DDS: it is heard, localized, and hears its pose."""

import json
import math
import os

import pytest
from dynpf_formats.recording.reader import read_recording

pytest.importorskip("cyclonedds", reason="this processor has no wheels of Cyclone DDS")

from tests.integration.processes import PATIENCE_S, until
from tests.integration.robots import MAP, ODOMETRY, POSE, SCAN, Messages
from tests.ros2.oracle import oracle_in, plain

LOOPBACK = """<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
KNOWN = 'estimator.start={kind="known", x=0.3, y=0.1, sigma_position=0.1, sigma_heading=0.05}'


def test_a_node_of_ros_on_dds_is_localized_and_hears_its_pose(tmp_path, dynpf, here, types, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain, path = 1 + os.getpid() % 100, tmp_path / "live.mcap"
    robot = Messages(types)
    with oracle_in(tmp_path) as theirs:
        theirs.ask("node", domain=domain)
        theirs.ask("node_latches", name="/map", kind=MAP, told=plain(robot.room()))
        theirs.ask("node_hears", name="/amcl_pose", kind=POSE, latched=True)
        messages = {"/scan": [SCAN, plain(robot.scan(0))], "/odom": [ODOMETRY, plain(robot.pose(0))]}
        theirs.ask("node_repeats", messages=messages, every_s=0.05)
        words = ["bridge", "ros2", "laser-log", "--dds", "--domain", domain, "-o", path, "--no-page", "--json"]
        run = dynpf(*words, "--set", "estimator.min_travel=0.0", "--set", KNOWN)

        def poses():
            told = theirs.ask("heard", name="/amcl_pose", least=1, within_s=0.1)
            return [(one["pose"]["pose"]["position"]["x"], one["pose"]["pose"]["position"]["y"]) for one in told]

        def answered(place, within):
            until(
                lambda: run.popen.poll() is not None or any(math.dist(pose, place) < within for pose in poses()),
                "a pose",
            )
            assert run.popen.poll() is None, run.stderr

        answered((0.3, 0.1), 0.3)
        theirs.ask("node_publishes", name="/initialpose", kind=POSE, told=plain(robot.initial_pose(-1.2, 1.3)))
        answered((-1.2, 1.3), 0.1)
        run.interrupt()
        assert run.wait(PATIENCE_S) == 0, run.stderr
    assert "hears /scan, odometry /odom, base base" in run.stderr
    assert any(attachment.name == "files/map.yaml" for attachment in read_recording(path).attachments)
    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.err
    assert json.loads(replayed.out)["same"]
