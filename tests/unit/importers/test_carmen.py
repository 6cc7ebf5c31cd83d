"""The CARMEN importer: small logs of known content, what is wrong in logs, and the real ones read independently."""

import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import Record
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState, Scanner, heading

REAL = Path(__file__).parents[3] / "../shared/data/carmen"
real = pytest.mark.skipif(not REAL.is_dir(), reason=f"the CARMEN logs are not at {REAL}")

RAW = """\
# message formats defined: PARAM SYNC ODOM FLASER RLASER TRUEPOS
PARAM robot_frontlaser_offset 0.1 nohost 0
PARAM robot_front_laser_max 20.0 nohost 0
ODOM 1.0 2.0 0.5 0.1 0 0 10.5 host 10.6
FLASER 4 1.5 2.5 81.83 20.0 1.1 2.0 0.5 1.0 2.0 0.5 10.6 host 10.7
ODOM 1.1 2.0 7.0 0.1 0 0 10.55 host 10.8
"""
CORRECTED = """\
ODOM 0 0 0 0 0 0 1.0 host 1.0
ODOM 1 0 0 0 0 0 2.0 host 2.0
FLASER 2 1 2 5 5 1.5707963267948966 5 5 1.5707963267948966 2.0 host 2.0
ODOM 5 5 1.5707963267948966 0 0 0 1e-300 host 1e-300
NEFF 15
ODOM 5 7 1.5707963267948966 0 0 0 3.0 host 3.0
FLASER 2 1 2 9 9 0 9 9 0 3.0 host 3.0
ODOM 9 9 0 0 0 0 -2.9 host -2.9
ODOM 9 8 0 0 0 0 4.0 host 4.0
"""


def records(tmp_path: Path, text: str) -> list[Record]:
    path = tmp_path / "log.txt"
    path.write_text(text)
    return list(import_carmen(path).records)


def poses(found: list[Record], topic: str) -> list[tuple[float, float, float]]:
    told = []
    for message in (one.message for one in found if one.topic == topic):
        assert isinstance(message, OdometryPose | RobotState)
        told.append((message.x, message.y, message.theta))
    return told


def test_a_raw_log_comes_in_file_order_with_its_own_times_and_poses(tmp_path: Path) -> None:
    first, scanner, scan, last = records(tmp_path, RAW)
    assert first == Record("log/odometry_pose", 10_500_000_000, OdometryPose(x=1.0, y=2.0, theta=0.5))
    assert last.stamp_ns == 10_550_000_000
    assert last.message == OdometryPose(x=1.1, y=2.0, theta=pytest.approx(7.0 - math.tau))  # type: ignore[arg-type]
    assert scanner == Record("log/scanner", 10_600_000_000, Scanner(range_max=20.0))
    assert (scan.topic, scan.stamp_ns) == ("log/scan", 10_600_000_000)
    assert isinstance(scan.message, LaserScan)
    assert scan.message.ranges == (1.5, 2.5, 20.0, 20.0)
    assert (scan.message.pose.position.x, heading(scan.message.pose.orientation)) == (0.1, 0.0)


@pytest.mark.parametrize(("beams", "last"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0)])
def test_beams_begin_at_the_right_and_an_even_number_leaves_out_the_last(
    tmp_path: Path, beams: int, last: float
) -> None:
    (scan,) = (one.message for one in records(tmp_path, flaser(beams)) if one.topic == "log/scan")
    assert isinstance(scan, LaserScan)
    assert math.degrees(scan.start_angle) == pytest.approx(-90.0)
    assert math.degrees(scan.end_angle) == pytest.approx(last)


def flaser(beams: int) -> str:
    return f"FLASER {beams} {'1.0 ' * beams} 0 0 0 0 0 0 1.0 host 1.0\n"


def test_raw_odometry_is_restored_from_a_corrected_log_whatever_time_its_restarts_have(tmp_path: Path) -> None:
    found = records(tmp_path, CORRECTED)
    assert poses(found, "log/odometry_pose") == [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        pytest.approx((3.0, 0.0, 0.0)),  # 2 m ahead of where the scan was corrected to
        pytest.approx((3.0, -1.0, -math.pi / 2 + math.pi / 2)),
    ]
    assert poses(found, "log/truth") == [(5.0, 5.0, pytest.approx(math.pi / 2)), (9.0, 9.0, 0.0)]
    topics = [one.topic for one in found]
    at = topics.index("log/truth")
    assert topics[at : at + 3] == ["log/truth", "log/scanner", "log/scan"]
    assert topics.count("log/scanner") == 1


def test_without_odom_lines_the_laser_lines_give_odometry(tmp_path: Path) -> None:
    text = "FLASER 1 2.0 1.0 0 0 1.0 0 0 1.0 h 1.0\nFLASER 1 2.0 8.0 0 0 1.5 0 0 2.0 h 2.0\n"
    found = records(tmp_path, text)
    assert poses(found, "log/odometry_pose") == [(1.0, 0.0, 0.0), (1.5, 0.0, 0.0)]
    assert poses(found, "log/truth") == [(1.0, 0.0, 0.0), (8.0, 0.0, 0.0)]


def test_a_robotlaser_line_tells_its_own_geometry_and_is_taken_before_the_same_flaser(tmp_path: Path) -> None:
    line = (
        "ROBOTLASER1 0 -1.0 2.0 0.5 30.0 0.01 0 5 1 2 31 nan -1 2 0.5 0.6 "
        "0.2 0.3 1.57 0 0 1.57 0.1 0.2 0.3 0.4 0.5 7.25 host 7.3\n"
    )
    path = tmp_path / "log.txt"
    path.write_text(flaser(180) + line)
    log = import_carmen(path)
    odometry, scanner, scan = log.records
    assert scanner.message == Scanner(range_max=30.0)
    assert odometry == Record("log/odometry_pose", 7_250_000_000, OdometryPose(x=0.0, y=0.0, theta=1.57))
    assert isinstance(scan.message, LaserScan)
    assert (scan.message.start_angle, scan.message.end_angle) == (-1.0, 1.0)
    assert scan.message.ranges == (1.0, 2.0, 30.0, 30.0, 30.0)
    mount = scan.message.pose.position
    assert (mount.x, mount.y) == pytest.approx((0.3, -0.2), abs=1e-3)
    assert {reason: lost.count for reason, lost in log.losses.summary().items()} == {
        "FLASER lines, the same scans again": 1,
        "beams that are not a number": 1,
        "beams not above the least range": 1,
    }


def test_where_the_range_changes_within_a_log_the_scanner_is_told_again(tmp_path: Path) -> None:
    def line(range_max: float, at: float) -> str:
        poses = "0.2 0.3 0.0 0 0 0.0 0.1 0.2 0.3 0.4 0.5"
        return f"ROBOTLASER1 0 -1.0 2.0 1.0 {range_max} 0.01 0 2 1.0 2.0 0 {poses} {at} host {at}\n"

    found = records(tmp_path, "".join(line(*one) for one in ((30, 1), (30, 2), (20, 3), (20, 4), (30, 5))))
    told = []
    for one in found:
        if one.topic == "log/scanner":
            assert isinstance(one.message, Scanner)
            told.append((one.stamp_ns // 10**9, one.message.range_max))
    assert told == [(1, 30.0), (3, 20.0), (5, 30.0)]


def test_the_true_pose_of_a_simulated_log_is_the_reference(tmp_path: Path) -> None:
    found = records(tmp_path, RAW + "TRUEPOS 1 2 0.5 3 4 0.6 10.7 host 10.9\n")
    assert poses(found, "log/truth") == [(1.0, 2.0, 0.5)]


def test_lines_that_cannot_be_read_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    bad = "ODOM 1.0 nan 0.5 0.1 0 0 10.5 host 10.6\nFLASER 400 1.0 2.0\nODOM 1 2\nODOM 0 0 0 0 0 0 -1 h 0\n"
    path.write_text(RAW + bad + "FLASER 2 1.0 x 0 0 0 0 0 0 1 h 1\n")
    log = import_carmen(path)
    assert len(list(log.records)) == 4
    (lost,) = log.losses.summary().values()
    assert (lost.count, lost.first) == (5, "log.txt:7: y is 'nan'; expected a finite number")


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "the file is empty"),
        (b"hello\n", "no FLASER or ROBOTLASER1 line that can be read"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a Git LFS pointer, not the file itself"),
        (gzip.compress(RAW.encode())[:-20], "cannot be read beyond line"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line_and_leaves_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], data: bytes, told: str
) -> None:
    source, output = tmp_path / "log", tmp_path / "new.mcap"
    source.write_bytes(data)
    assert main(["import", "carmen", str(source), "-o", str(output)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"dynpf import: {source}: ")
    assert told in line
    assert not output.exists()


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ImportFailedError, match="no such file"):
        import_carmen(tmp_path / "none")


def test_the_command_tells_what_it_wrote_and_twice_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "log"
    source.write_text(CORRECTED)
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for output in (first, second):
        assert main(["import", "carmen", str(source), "-o", str(output), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[0])
    assert told["messages"] == {"log/odometry_pose": 4, "log/scan": 2, "log/scanner": 1, "log/truth": 2}
    assert told["dropped"] == {"NEFF lines": {"count": 1, "first": "log:5"}}
    assert (told["start_ns"], told["duration_s"]) == (10**9, 3.0)
    assert content_digest(read_recording(first)) == content_digest(read_recording(second))
    source.write_text(CORRECTED.replace("NEFF", "ODOM 0 0 0 0 0 0 2.5 host"))
    third = tmp_path / "c.mcap"
    assert main(["import", "carmen", str(source), "-o", str(third)]) == 0
    assert content_digest(read_recording(third)) != content_digest(read_recording(first))


@real
@pytest.mark.parametrize(
    ("name", "beams", "counts"),
    [
        ("intel-corrected.log.gz", 180, {"ODOM": 14541, "FLASER": 910}),
        ("freiburg-101-corrected.log.gz", 360, {"ODOM": 4569, "FLASER": 292}),
    ],
)
def test_a_real_log_comes_over_record_by_record(tmp_path: Path, name: str, beams: int, counts: dict[str, int]) -> None:
    output = tmp_path / "log.mcap"
    assert main(["import", "carmen", str(REAL / name), "-o", str(output)]) == 0
    with gzip.open(REAL / name, "rt") as stream:
        lines = [line.split() for line in stream]
    lasers = [line for line in lines if line[0] == "FLASER"]
    odoms = [line for line in lines if line[0] == "ODOM"]
    assert (len(odoms), len(lasers)) == (counts["ODOM"], counts["FLASER"])
    recording = read_recording(output)
    found = {topic: list(recording.messages(topic)) for topic in ("log/odometry_pose", "log/scan", "log/truth")}
    # Every scan is followed by one line that starts odometry anew, which is no record.
    assert len(found["log/odometry_pose"]) == counts["ODOM"] - counts["FLASER"]
    for record, line in zip(found["log/scan"], lasers, strict=True):
        scan = decode("log/scan", record.payload)
        assert isinstance(scan, LaserScan)
        assert scan.ranges == pytest.approx([min(float(text), 80.99) for text in line[2 : 2 + beams]], abs=1.0)
        assert [r for r in scan.ranges if r < 80] == [float(t) for t in line[2 : 2 + beams] if float(t) < 80]
        assert record.stamp_ns == round(float(line[8 + beams]) * 1e9)
    for record, line in zip(found["log/truth"], lasers, strict=True):
        pose = decode("log/truth", record.payload)
        assert isinstance(pose, RobotState)
        assert (pose.x, pose.y, pose.theta) == tuple(map(float, line[2 + beams : 5 + beams]))
    path = []
    for record in found["log/odometry_pose"]:
        pose = decode("log/odometry_pose", record.payload)
        assert isinstance(pose, OdometryPose)
        path.append((pose.x, pose.y))
    assert np.array(path) == pytest.approx(np.array(chained(lines, beams)), abs=1e-9)
    assert found["log/odometry_pose"][-1].stamp_ns == round(float(odoms[-1][7]) * 1e9)


def chained(lines: list[list[str]], beams: int) -> list[tuple[float, float]]:
    """Positions of raw odometry by complex numbers: each increment turned from the file's frame into the raw one."""
    raw, turn, last, found = 0j, 1 + 0j, None, []
    for line in lines:
        if line[0] == "FLASER":
            corrected = tuple(line[2 + beams : 5 + beams])
        if line[0] != "ODOM":
            continue
        x, y, theta = map(float, line[1:4])
        here, facing = complex(x, y), complex(math.cos(theta), math.sin(theta))
        if last is None:
            raw, turn = here, 1 + 0j
        elif tuple(line[1:4]) == corrected:
            turn *= last[1] / facing
            last, corrected = (here, facing), ()
            continue
        else:
            raw += (here - last[0]) * turn
        corrected = corrected if last is not None else ()
        found.append((raw.real, raw.imag))
        last = here, facing
    return found
