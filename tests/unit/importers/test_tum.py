"""The importer of TUM trajectories: poses alone, and as the reference of a log."""

import math
from pathlib import Path

import pytest
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import Record
from dynpf_formats.importers.tum import import_tum
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import RobotState

POSES = """\
# timestamp tx ty tz qx qy qz qw
1305031102.175304123 1.5 -2.0 0.3 0 0 0.7071067811865476 0.7071067811865476
1305031102.2 1.5 -1.0 0.3 0 0 -2 2  # not of length 1, as some write them
1305031102.1 9 9 9 0 0 0 1
1305031102.3 9 9 9 0 0 0 0
1305031102.3 9 9 nan 0 0 0 1
1305031102.3 9 9 0 0 0 1
"""


def test_poses_keep_their_nanoseconds_and_headings_and_what_is_wrong_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "truth.txt"
    path.write_text(POSES)
    log = import_tum(path)
    assert list(log.records) == [
        Record("log/truth", 1305031102_175304123, RobotState(x=1.5, y=-2.0, theta=pytest.approx(math.pi / 2))),  # type: ignore[arg-type]
        Record("log/truth", 1305031102_200000000, RobotState(x=1.5, y=-1.0, theta=pytest.approx(-math.pi / 2))),  # type: ignore[arg-type]
    ]
    dropped = log.losses.summary()
    assert dropped["poses whose clock went backwards"].first == "truth.txt:4: 1305031102.1 s"
    assert (dropped["lines that cannot be read"].count, dropped["lines that cannot be read"].first) == (
        3,
        "truth.txt:5: quaternion is 0 0 0 0; expected one of length 1",
    )


def test_poses_become_the_reference_of_a_log_in_the_place_of_its_own(tmp_path: Path) -> None:
    source, poses = tmp_path / "log.txt", tmp_path / "truth.txt"
    first, second, third = tmp_path / "a.mcap", tmp_path / "b.mcap", tmp_path / "c.mcap"
    source.write_text(
        "FLASER 1 2.0 1 0 0 1 0 0 1.0 h 1.0\nODOM 1 0 0 0 0 0 2.0 h 2.0\nTRUEPOS 7 7 7 1 0 0 2.5 h 2.5\n"
        "FLASER 1 3.0 1 0 0 1 0 0 3.0 h 3.0\n"
    )
    poses.write_text("1.5 5 0 0 0 0 0 1\n2.0 6 0 0 0 0 0 1\n9.0 8 0 0 0 0 0 1\n")
    assert main(["import", "carmen", str(source), "-o", str(first)]) == 0
    for output in (second, third):
        assert main(["import", "tum", str(poses), "--log", str(first), "-o", str(output)]) == 0
    recording = read_recording(second)
    found = [(one.topic, one.stamp_ns // 10**8) for one in recording.messages()]
    assert found == [
        ("log/scanner", 10),
        ("log/scan", 10),
        ("log/truth", 15),
        ("log/truth", 20),
        ("log/odometry_pose", 20),
        ("log/scan", 30),
        ("log/truth", 90),
    ]
    assert [decode("log/truth", one.payload) for one in recording.messages("log/truth")] == [
        RobotState(x=x, y=0.0, theta=0.0) for x in (5.0, 6.0, 8.0)
    ]
    old = {one.payload for one in read_recording(first).messages("log/scan")}
    assert {one.payload for one in recording.messages("log/scan")} == old
    assert content_digest(recording) == content_digest(read_recording(third))


def test_a_file_without_poses_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth.txt"
    path.write_text("# nothing\n1 2 3\n")
    with pytest.raises(ImportFailedError, match=r"no pose can be read: .*; expected time"):
        import_tum(path)
