"""The importer of ROS bags: the same small log in every format, every way to be broken, and real bags read apart."""

import bz2
import contextlib
import json
import math
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zstandard

pytest.importorskip("rosbags", reason="the package rosbags is not installed")

import lz4.frame
from dynpf_formats.importers.bag_bounds import bound_chunks
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Record
from dynpf_formats.importers.ordered import BACKWARDS, LEAPT
from dynpf_formats.importers.rosbag import BagChoice, import_rosbag
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.localize.sources import imported, source_of
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState, Scanner, heading
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag1.reader import Chunk
from rosbags.rosbag2 import StoragePlugin

from dynpf.maps.map_server import decode as decode_map
from tests.unit.importers import bags
from tests.unit.importers.bags import Said, write_ros1, write_ros2, yaw

REAL = Path(__file__).parents[3] / "../shared/data/bags"
real = pytest.mark.skipif(not REAL.is_dir(), reason=f"the bags are not at {REAL}")

T = 10**9
S = 1_700_000_000 * T
GRID = [[0, 100, -1], [25, 66, 0]]
LOG: list[Said] = [
    ("/tf_static", S, bags.transform(S, "base_link", "laser", (0.2, 0.1, 0.5), yaw(math.pi / 2))),
    ("/map", S, bags.grid(GRID, 0.5, -1.0, 2.0, 0.5)),
    ("/odom", S + 20, bags.odometry(S, 1.0, 2.0, 0.5)),
    ("/odom", S + T // 2, bags.odometry(S + T // 2, 1.5, 2.0, -3.0)),
    # A scan of before the last odometry that took its time to come.
    ("/scan", S + 6 * T // 10, bags.scan(S + T // 4, [1.0, 2.0, 11.0, float("nan"), 0.05])),
    ("/ground_truth/pose", S + 6 * T // 10, bags.pose(S + T // 4, 3.0, 4.0, yaw(1.0))),
    ("/rosout_like", S + T, bags.pose(S, 0.0, 0.0, yaw(0.0))),
    ("/scan", S + T, bags.scan(S + T, [1.0, 2.0, 3.0, 4.0, float("inf")])),
]


def bag(tmp_path: Path, said: Sequence[Said] = LOG, name: str = "log") -> Path:
    return write_ros1(tmp_path / f"{name}.bag", said)


def taken(log: ImportedLog) -> list[Record]:
    return list(log.records)


def lost(log: ImportedLog) -> dict[str, int]:
    return {reason: dropped.count for reason, dropped in log.losses.summary().items()}


def test_records_come_in_the_order_of_their_own_stamps(tmp_path: Path) -> None:
    log = import_rosbag(bag(tmp_path))
    found = taken(log)
    assert [(one.topic, one.stamp_ns - S) for one in found] == [
        ("log/odometry_pose", 0),
        ("log/truth", T // 4),
        ("log/scanner", T // 4),
        ("log/scan", T // 4),
        ("log/odometry_pose", T // 2),
        ("log/scan", T),
    ]
    assert found[0].message == OdometryPose(x=1.0, y=2.0, theta=pytest.approx(0.5))  # type: ignore[arg-type]
    assert found[1].message == RobotState(x=3.0, y=4.0, theta=pytest.approx(1.0))  # type: ignore[arg-type]
    assert found[2].message == Scanner(range_min=pytest.approx(0.1), range_max=10.0)  # type: ignore[arg-type]
    scan = found[3].message
    assert isinstance(scan, LaserScan)
    assert (scan.start_angle, scan.end_angle) == (-1.0, 1.0)
    assert scan.ranges == (1.0, 2.0, 10.0, 10.0, 10.0)
    mount = scan.pose
    assert (mount.position.x, mount.position.y) == pytest.approx((0.2, 0.1))
    assert heading(mount.orientation) == pytest.approx(math.pi / 2)
    assert lost(log) == {"beams that are not a number": 1, "beams not above the least range": 1}
    assert log.settings["topics_left_out"] == {"/rosout_like": "geometry_msgs/msg/PoseStamped"}


def test_a_scanner_whose_range_changes_is_told_again_in_the_order_of_the_stamps(tmp_path: Path) -> None:
    # Of the second and third scan the later one arrives first: by arrival the last one's range would be known already.
    scans = [(0, 0, 10.0), (3, 3, 10.0), (2, 4, 5.0), (5, 5, 5.0)]
    said = [
        ("/scan", S + arrival * T // 10, bags.scan(S + at * T // 10, [1.0] * 5, range_max=range_max))
        for at, arrival, range_max in scans
    ]
    found = [one for one in taken(import_rosbag(bag(tmp_path, [*LOG[:3], *said]))) if "scan" in one.topic]
    told = [(one.topic, (one.stamp_ns - S) * 10 // T, getattr(one.message, "range_max", None)) for one in found]
    assert told == [
        ("log/scanner", 0, 10.0),
        ("log/scan", 0, None),
        ("log/scanner", 2, 5.0),
        ("log/scan", 2, None),
        ("log/scanner", 3, 10.0),
        ("log/scan", 3, None),
        ("log/scanner", 5, 5.0),
        ("log/scan", 5, None),
    ]


def test_every_format_gives_the_same_recording_and_so_does_every_import(tmp_path: Path) -> None:
    sources = [
        bag(tmp_path),
        write_ros1(tmp_path / "bz2.bag", LOG, Writer1.CompressionFormat.BZ2),
        write_ros2(tmp_path / "sqlite", LOG, StoragePlugin.SQLITE3),
        write_ros2(tmp_path / "mcap", LOG, StoragePlugin.MCAP),
        next((tmp_path / "mcap").glob("*.mcap")),
        bag(tmp_path, name="again"),
    ]
    digests = []
    for number, source in enumerate(sources):
        output = tmp_path / f"{number}.mcap"
        assert main(["import", "rosbag", str(source), "-o", str(output)]) == 0
        digests.append(content_digest(read_recording(output)))
    assert len(set(digests)) == 1
    other = bag(tmp_path, [*LOG[:-1], ("/scan", S + T, bags.scan(S + T, [1.0, 2.0, 3.0, 4.5, 5.0]))], "other")
    assert main(["import", "rosbag", str(other), "-o", str(tmp_path / "other.mcap")]) == 0
    assert content_digest(read_recording(tmp_path / "other.mcap")) != digests[0]


def test_the_map_is_attached_cell_by_cell_as_map_server_keeps_it(tmp_path: Path) -> None:
    files = {one.name: one.data for one in import_rosbag(bag(tmp_path)).attachments}
    assert files.keys() == {"files/map.yaml", "files/map.pgm"}
    grid = decode_map(files["files/map.yaml"].decode(), lambda name: files["files/" + name], "map.yaml")
    assert grid.cells.tolist() == [[0, 1, 2], [2, 1, 0]]
    assert grid.resolution == 0.5
    assert grid.origin[:2] == (-1.0, 2.0)
    assert grid.origin[2] == pytest.approx(0.5)


def test_a_map_whose_origin_is_not_a_number_is_left_out_and_told(tmp_path: Path) -> None:
    said = [("/map", S, bags.grid(GRID, 0.5, float("nan"), 2.0, 0.5)), *LOG[2:]]
    log = import_rosbag(bag(tmp_path, said))
    assert log.attachments == ()
    assert log.losses.summary()["maps"].first == "/map: its origin is not a pose of finite numbers"


def test_a_topic_has_one_type(tmp_path: Path) -> None:
    path = next(write_ros2(tmp_path / "bag", LOG, StoragePlugin.SQLITE3).glob("*.db3"))
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("update topics set name = '/map' where name = '/odom'")
    assert lost(import_rosbag(path))["messages of another type"] == 1


def test_a_bag_that_defines_ever_more_types_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynpf_formats.importers.bags.MOST_DEFINITIONS", 2)
    with pytest.raises(ImportFailedError, match=r"it defines 5 types of messages; at most 2 are read"):
        import_rosbag(bag(tmp_path))


def test_odometry_comes_from_tf_where_there_is_no_topic_of_it(tmp_path: Path) -> None:
    said: list[Said] = [
        ("/tf", S, bags.transform(S, "base_footprint", "base_link", (0.0, 0.0, 0.1))),
        ("/tf", S, bags.transform(S, "base_link", "laser", (0.2, 0.0, 0.0))),
        ("/tf", S + 1, bags.transform(S, "odom", "base_footprint", (1.0, 0.0, 0.0), yaw(0.25))),
        ("/tf", S + 2, bags.transform(S, "odom", "base_footprint", (1.0, 0.0, 0.0), yaw(0.25))),
        ("/tf", S + 3, bags.transform(S + 3, "odom", "map", (9.0, 0.0, 0.0))),
        ("/scan", S + 9, bags.scan(S + 9, [1.0])),
    ]
    log = import_rosbag(bag(tmp_path, said))
    first, _, scan = taken(log)
    assert first == Record("log/odometry_pose", S, OdometryPose(x=1.0, y=0.0, theta=pytest.approx(0.25)))  # type: ignore[arg-type]
    assert isinstance(scan.message, LaserScan)
    assert scan.message.pose.position.x == pytest.approx(0.2)
    assert lost(log) == {"repeated odometry": 1}


def test_a_scanner_that_hangs_upside_down_turns_the_other_way(tmp_path: Path) -> None:
    hung = bags.transform(S, "base_link", "laser", (0.2, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    said = [("/tf_static", S, hung), *LOG[2:4], ("/scan", S, bags.scan(S, [1.0, 2.0, 3.0, 4.0, 5.0]))]
    scan = next(one.message for one in taken(import_rosbag(bag(tmp_path, said))) if one.topic == "log/scan")
    assert isinstance(scan, LaserScan)
    assert (scan.start_angle, scan.end_angle) == (1.0, -1.0)


def test_of_several_scanners_the_widest_is_taken_unless_another_is_named(tmp_path: Path) -> None:
    wide = ("/wide", S + T, bags.scan(S + T, [1.0] * 9, frame="laser"))
    path = bag(tmp_path, [*LOG, wide])
    assert import_rosbag(path).settings["scan"] == "/wide"
    assert import_rosbag(path, BagChoice(scan="/scan")).settings["scan"] == "/scan"
    with pytest.raises(ImportFailedError, match="no topic /odom for the scan; the bag has /scan, /wide"):
        import_rosbag(path, BagChoice(scan="/odom"))
    for wanted, taken_scan in (("scan", "/scan"), ("/scan", "/scan"), ("other", "/wide"), (None, "/wide")):
        log = imported(source_of(path), None, wanted)
        assert log is not None
        assert log.settings["scan"] == taken_scan


def test_the_truth_is_moved_into_the_map_and_in_time(tmp_path: Path) -> None:
    choice = BagChoice(truth_offset=(3.0, 3.0, math.pi / 2), truth_shift=0.1)
    (truth,) = (one for one in taken(import_rosbag(bag(tmp_path), choice)) if one.topic == "log/truth")
    assert truth.stamp_ns == S + T // 4 + T // 10
    assert isinstance(truth.message, RobotState)
    assert (truth.message.x, truth.message.y, truth.message.theta) == pytest.approx((1.0, 0.0, 1.0 - math.pi / 2))


def test_a_cloud_becomes_the_scan_of_a_kinect(tmp_path: Path) -> None:
    # In the optical frame x is to the right, y down and z ahead; the camera is 0.3 m above the floor.
    tilt = (-0.5, 0.5, -0.5, 0.5)
    points = [
        (0.0, 0.0, 2.0),  # ahead
        (0.0, 0.1, 1.9),  # nearer, below it
        (0.0, 0.29, 1.0),  # the floor, all but
        (0.0, -5.0, 1.0),  # the ceiling
        (-0.5, 0.0, 1.0),  # to the left, at atan(0.5)
        (0.0, 0.0, 0.3),  # too near
        (0.1, 0.0, 5.0),  # too far
        (float("nan"), 0.0, 1.0),
    ]
    said: list[Said] = [
        ("/tf_static", S, bags.transform(S, "base_link", "camera_optical", (0.1, 0.0, 0.3), tilt)),
        *LOG[2:4],
        ("/camera", S + T, bags.cloud(S + T, points, "camera_optical")),
    ]
    scan = next(one.message for one in taken(import_rosbag(bag(tmp_path, said))) if one.topic == "log/scan")
    assert isinstance(scan, LaserScan)
    angles = np.linspace(scan.start_angle, scan.end_angle, len(scan.ranges))
    assert math.degrees(scan.end_angle - scan.start_angle) == pytest.approx(57.8)
    seen = {round(math.degrees(angle)): near for angle, near in zip(angles, scan.ranges, strict=True) if near < 4.0}
    assert seen == {0: pytest.approx(1.9), 26: pytest.approx(math.hypot(0.5, 1.0))}
    assert (scan.pose.position.x, heading(scan.pose.orientation)) == pytest.approx((0.1, 0.0))


def test_a_clock_that_goes_backwards_or_leaps_is_left_out_and_counted(tmp_path: Path) -> None:
    def at(arrival: int, stamp: int) -> Said:
        return ("/odom", S + arrival, bags.odometry(S + stamp, float(stamp // T), 0.0, 0.0))

    said = [at(0, 0), at(1, 10 * T), at(2, 5 * T), at(3, 500 * T), at(4, 11 * T), at(5, 10 * T), *scans_at(S + 12 * T)]
    log = import_rosbag(bag(tmp_path, said))
    stamps = [(one.stamp_ns - S) // T for one in taken(log) if one.topic == "log/odometry_pose"]
    assert stamps == [0, 10, 10, 11]
    assert lost(log)["records whose clock went backwards"] == 1
    assert lost(log)["records whose clock leapt ahead"] == 1


@pytest.mark.parametrize("wrong", [-3600 * T, 3600 * T])
@pytest.mark.parametrize("place", [0, 1, 7, 19])
def test_one_bad_stamp_costs_one_record_wherever_it_stands(wrong: int, place: int, tmp_path: Path) -> None:
    def odometry(number: int, shift_ns: int) -> Said:
        stamp_ns = S + 7200 * T + number * T // 10
        return ("/odom", stamp_ns, bags.odometry(stamp_ns + shift_ns, float(number), 0.0, 0.0))

    said = [odometry(number, wrong if number == place else 0) for number in range(20)]
    log = import_rosbag(bag(tmp_path, [*said, *scans_at(S + 7203 * T)]))
    kept = [one.message.x for one in taken(log) if isinstance(one.message, OdometryPose)]
    assert kept == [number for number in range(20) if number != place]
    assert sum(lost(log)[reason] for reason in (BACKWARDS, LEAPT) if reason in lost(log)) == 1


def test_a_clock_that_is_set_goes_on(tmp_path: Path) -> None:
    def odometry(number: int) -> Said:
        arrival_ns = S + number * T // 10
        stamp_ns = number * T // 10 + T if number < 10 else arrival_ns
        return ("/odom", arrival_ns, bags.odometry(stamp_ns, float(number), 0.0, 0.0))

    log = import_rosbag(bag(tmp_path, [*map(odometry, range(20)), *scans_at(S + 2 * T)]))
    assert [one.message.x for one in taken(log) if isinstance(one.message, OdometryPose)] == [*range(20)]


def test_everything_is_of_the_robot_whose_scan_is_taken(tmp_path: Path) -> None:
    said: list[Said] = []
    for number in range(4):
        stamp_ns = S + number * T // 10
        for robot, sign in (("robot1", 1.0), ("robot2", -1.0)):
            link = bags.transform(stamp_ns, f"{robot}/base_link", f"{robot}/laser", (0.3 * sign, 0.0, 0.0), yaw(0.0))
            moved = bags.transform(stamp_ns, f"{robot}/odom", f"{robot}/base_link", (number * sign, 0, 0), yaw(0.0))
            scan = bags.scan(stamp_ns, [2.0, 2.0], f"{robot}/laser")
            said += [("/tf", stamp_ns, link), ("/tf", stamp_ns, moved), (f"/{robot}/scan", stamp_ns, scan)]
            said += [(f"/{robot}/mocap/pose", stamp_ns, bags.pose(stamp_ns, 10 * sign, 0.0, yaw(0.0)))]
    log = import_rosbag(bag(tmp_path, said), BagChoice(scan="/robot2/scan"))
    records = taken(log)
    assert [one.message.x for one in records if isinstance(one.message, OdometryPose)] == [0.0, -1.0, -2.0, -3.0]
    assert {one.message.x for one in records if isinstance(one.message, RobotState)} == {-10.0}
    assert log.settings["scanner_x_m"] == pytest.approx(-0.3)


def test_scans_as_drivers_leave_them(tmp_path: Path) -> None:
    """Failed beams that read 0, a step of 0 beside a last angle, and no greatest range."""
    endless = {"range_min": 0.0, "range_max": math.inf, "angle_increment": 0.0, "angle_max": 1.0}
    said = [LOG[2], ("/scan", S + T, bags.scan(S + T, [2.0, 0.0, math.inf, 150.0], "laser", **endless))]
    scan = next(one.message for one in taken(import_rosbag(bag(tmp_path, said))) if isinstance(one.message, LaserScan))
    assert scan.ranges == (2.0, 300.0, 300.0, 150.0)
    assert (scan.start_angle, scan.end_angle) == pytest.approx((-1.0, 1.0))
    flat = {"angle_increment": 0.0, "angle_max": -1.0}
    log = import_rosbag(
        bag(tmp_path, [*LOG, ("/scan", S + 2 * T, bags.scan(S + 2 * T, [2.0, 2.0], "laser", **flat))], "flat")
    )
    taken(log)
    assert lost(log)["scans without a geometry"] == 1


def scans_at(stamp_ns: int) -> list[Said]:
    return [("/scan", stamp_ns, bags.scan(stamp_ns, [1.0], "base_link"))]


def test_what_is_no_number_is_left_out_and_counted(tmp_path: Path) -> None:
    said: list[Said] = [
        *LOG,
        ("/odom", S + T, bags.odometry(S + T, float("nan"), 0.0, 0.0)),
        ("/ground_truth/pose", S + T, bags.pose(S + T, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0))),
        ("/scan", S + T, bags.scan(S + T, [])),
        ("/scan", S + T, bags.scan(S + T, [1.0], angle_min=float("nan"))),
        ("/scan", S + 2 * T, bags.scan(0, [1.0])),
    ]
    log = import_rosbag(bag(tmp_path, said))
    assert taken(log)[-1].stamp_ns == S + 2 * T
    found = lost(log)
    assert found["poses that are not finite numbers"] == 1
    assert found["poses whose quaternion has no length"] == 1
    assert found["scans without beams or with too many"] == 1
    assert found["scans without a geometry"] == 1
    assert found["stamps of 0, replaced by the time of arrival"] == 1


def test_what_the_bag_lacks_is_told(tmp_path: Path) -> None:
    log = import_rosbag(bag(tmp_path, [LOG[4]]))
    assert log.settings["odometry"] is None
    assert lost(log) == {"transforms that the bag lacks, taken as none": 1, "odometry, which the bag lacks": 1}
    with pytest.raises(ImportFailedError, match=r"no sensor_msgs/msg/LaserScan .*; it has /odom \(nav_msgs"):
        import_rosbag(bag(tmp_path, LOG[2:4], "odometry_alone"))


def test_broken_bags_are_refused_in_one_line_and_leave_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = bag(tmp_path).read_bytes()
    (index_pos,) = struct.unpack("<Q", whole.partition(b"index_pos=")[2][:8])
    sqlite = next(write_ros2(tmp_path / "sqlite", LOG, StoragePlugin.SQLITE3).glob("*.db3")).read_bytes()
    mcap = next(write_ros2(tmp_path / "mcap", LOG, StoragePlugin.MCAP).glob("*.mcap")).read_bytes()
    chunk = whole.find(b"compression=none")
    broken = {
        "cut.bag": whole[: len(whole) // 2],
        "index.bag": whole[:index_pos] + b"\xff" * (len(whole) - index_pos),
        "unindexed.bag": whole.replace(b"index_pos=" + struct.pack("<Q", index_pos), b"index_pos=" + bytes(8)),
        "chunk.bag": whole[: chunk + 30] + b"\x00" * 200 + whole[chunk + 230 :],
        "fields.bag": whole.replace(b"float32[] ranges", b"float32[] rangez"),
        "pointer.bag": b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n",
        "empty.bag": b"",
        "text.bag": b"this is no bag\n",
        "log.txt": b"neither is this\n",
        "cut.db3": sqlite[: len(sqlite) // 2],
        "cut.mcap": mcap[: len(mcap) // 2],
        "none.mcap": b"\x89MCAP0\r\n",
        "many.mcap": with_chunk(mcap, bytes(9 * 1_600_000)),  # records without content, in 1.5 kB
        "large.mcap": with_chunk(mcap, bytes(80 * 2**20)),
    }
    output = tmp_path / "new.mcap"
    for name, data in broken.items():
        source = tmp_path / name
        source.write_bytes(data)
        capsys.readouterr()
        code = main(["import", "rosbag", str(source), "-o", str(output)])
        (line, *more) = capsys.readouterr().err.splitlines()
        assert (code, more) == (2, []), name
        assert line.startswith(f"dynpf import: {source}: "), name
        assert not output.exists(), name
        if name == "many.mcap":
            assert "more than 20" in line
            assert "records" in line


def with_chunk(mcap: bytes, content: bytes) -> bytes:
    """Return the beginning of a bag, a chunk, and an end without a summary, so that all records have to be read."""
    packed = zstandard.compress(content)
    fields = struct.pack("<QQQII4sQ", 0, 1, len(content), 0, 4, b"zstd", len(packed))
    chunk = struct.pack("<BQ", 6, len(fields) + len(packed)) + fields + packed
    header = mcap[: 8 + 9 + struct.unpack_from("<Q", mcap, 9)[0]]
    return header + chunk + struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + mcap[:8]


@pytest.mark.parametrize("compress", [bz2.compress, lz4.frame.compress])
def test_chunks_of_a_bag_unpack_to_what_a_chunk_may_hold(compress: Callable[[bytes], bytes]) -> None:
    decompress = {bz2.compress: bz2.decompress, lz4.frame.compress: lz4.frame.decompress}[compress]
    reader = SimpleNamespace(chunks={7: Chunk(0, 0, decompress), 8: Chunk(0, 0, bytes)})
    bound_chunks(reader)
    assert reader.chunks[7].decompressor(compress(b"a message")) == b"a message"
    assert reader.chunks[8].decompressor is bytes
    with pytest.raises(ValueError, match="unpacks to more than 67108864 bytes"):
        reader.chunks[7].decompressor(compress(bytes(2**26 + 1)))


def test_memory_does_not_grow_with_the_scans_in_a_bag(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        ranges = np.linspace(1.0, 9.0, 500).tolist()
        said = [("/scan", S + k * T // 10, bags.scan(S + k * T // 10, ranges, "base_link")) for k in range(count)]
        source = bag(tmp_path, [*LOG[2:4], *said], str(count))
        tracemalloc.start()
        for _ in import_rosbag(source).records:
            pass
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(50)  # what is loaded and kept once
    assert peak(400) - peak(100) < 1_000_000  # 300 records take over 5 MB


@real
@pytest.mark.parametrize(
    ("name", "topics", "counts"),
    [
        ("drl/jarvis_circular_path_fast.bag", ("/driver_laser_navigation/laser_scan", "tf"), (204, 638)),
        ("drl/jarvis_circular_path_fast_stage.bag", ("/base_scan", "/odom"), (257, 257)),
        ("uob_pioneer/simpath2.bag", ("/base_scan", "/odom"), (634, 634)),
    ],
)
def test_a_real_bag_comes_over_message_by_message(
    tmp_path: Path, name: str, topics: tuple[str, str], counts: tuple[int, int]
) -> None:
    output = tmp_path / "log.mcap"
    assert main(["import", "rosbag", str(REAL / name), "-o", str(output), "--json"]) == 0
    raw: dict[str, list[bytes]] = {}
    for topic, data in bags.raw_messages(REAL / name):
        raw.setdefault(topic, []).append(data)
    recording = read_recording(output)
    found = {topic: list(recording.messages(topic)) for topic in ("log/odometry_pose", "log/scan", "log/truth")}
    assert [record.stamp_ns for record in recording.messages()] == sorted(one.stamp_ns for one in recording.messages())

    scans = sorted(map(raw_scan, raw[topics[0]]))
    assert (len(found["log/scan"]), len(scans)) == (counts[0], counts[0])
    for record, (stamp_ns, start, step, least, greatest, ranges) in zip(found["log/scan"], scans, strict=True):
        scan = decode("log/scan", record.payload)
        assert isinstance(scan, LaserScan)
        assert record.stamp_ns == stamp_ns
        assert scan.start_angle == start
        assert scan.end_angle == pytest.approx(start + step * (len(ranges) - 1))
        assert scan.ranges == tuple(one if least <= one < greatest else greatest for one in ranges)

    if topics[1] == "tf":
        expected = sorted(one for data in raw["/tf"] for one in raw_odom_transforms(data))
    else:
        expected = sorted(map(raw_odometry, raw["/odom"]))
    assert (len(found["log/odometry_pose"]), len(expected)) == (counts[1], counts[1])
    for record, (stamp_ns, x, y, theta) in zip(found["log/odometry_pose"], expected, strict=True):
        pose = decode("log/odometry_pose", record.payload)
        assert isinstance(pose, OdometryPose)
        assert (record.stamp_ns, pose.x, pose.y) == (stamp_ns, x, y)
        assert math.remainder(pose.theta - theta, math.tau) == pytest.approx(0.0, abs=1e-12)
    assert len(found["log/truth"]) == counts[0]


def header_of(data: bytes) -> tuple[int, str, int]:
    """Return stamp, frame and the place behind a ROS 1 header."""
    _, seconds, nanoseconds, size = struct.unpack_from("<IIII", data)
    return seconds * T + nanoseconds, data[16 : 16 + size].decode(), 16 + size


def raw_scan(data: bytes) -> tuple[int, float, float, float, float, tuple[float, ...]]:
    stamp_ns, _, place = header_of(data)
    start, _, step, _, _, least, greatest, count = struct.unpack_from("<7fI", data, place)
    return stamp_ns, start, step, least, greatest, struct.unpack_from(f"<{count}f", data, place + 32)


def raw_odometry(data: bytes) -> tuple[int, float, float, float]:
    stamp_ns, _, place = header_of(data)
    (size,) = struct.unpack_from("<I", data, place)
    x, y, _, _, _, z, w = struct.unpack_from("<7d", data, place + 4 + size)
    return stamp_ns, x, y, 2.0 * math.atan2(z, w)


def raw_odom_transforms(data: bytes) -> Iterator[tuple[int, float, float, float]]:
    (count,) = struct.unpack_from("<I", data)
    data = data[4:]
    for _ in range(count):
        stamp_ns, parent, place = header_of(data)
        (size,) = struct.unpack_from("<I", data, place)
        child = data[place + 4 : place + 4 + size].decode()
        x, y, _, _, _, z, w = struct.unpack_from("<7d", data, place + 4 + size)
        data = data[place + 4 + size + 56 :]
        if (parent, child) == ("odom", "base_footprint"):
            yield stamp_ns, x, y, 2.0 * math.atan2(z, w)


@real
def test_the_summary_of_a_real_bag_tells_what_was_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = REAL / "drl/jarvis_circular_path_fast.bag"
    world = source.parent / "i-108_10mm.yaml"
    words = ["import", "rosbag", str(source), "--map", str(world), "-o", str(tmp_path / "log.mcap"), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["messages"] == {"log/odometry_pose": 638, "log/scan": 204, "log/scanner": 1, "log/truth": 204}
    assert told["settings"]["scanner_x_m"] == pytest.approx(0.194)
    assert told["attachments"] == ["files/i-108_10mm.yaml", "files/i-108_10mm.pgm"]
    files = {one.name: one.data for one in read_recording(tmp_path / "log.mcap").attachments}
    assert files["files/i-108_10mm.pgm"] == (source.parent / "i-108_10mm.pgm").read_bytes()


@pytest.mark.skipif(not (REAL / "../mcap").is_dir(), reason="the MCAP files are not there")
def test_real_files_without_a_scan_are_refused_in_one_line_whatever_else_is_in_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = REAL / "../mcap"
    sources = [*sorted(root.rglob("*.mcap")), *(one.parent for one in sorted(root.rglob("metadata.yaml")))]
    for source in sources:
        assert main(["import", "rosbag", str(source), "-o", str(tmp_path / "log.mcap")]) == 2, source
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"dynpf import: {source}: "), line
        assert "Could not parse" not in line  # what is of no use to us need not be understood
    assert len(sources) > 20
    assert not (tmp_path / "log.mcap").exists()
