"""The MRCLAM importer: a small data set of known content, every way in which one can be wrong, and a real one."""

import json
import lzma
import math
from collections import Counter
from pathlib import Path

import pytest
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Record
from dynpf_formats.importers.mrclam import import_mrclam
from dynpf_formats.recording.attachments import landmarks_of
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, Odometry, RobotState

ROBOTS = "readings of other robots"
BARCODES = "readings of unknown barcodes"
UNMAPPED = "readings of landmarks without a position"

REAL = Path(__file__).parents[3] / "../shared/data/mrclam"

TABLES = {
    "Barcodes.dat": "# Subject Barcode\n 1\t 5 \n 2 14\n 6 63\n 7 25\n 8 45\n",
    "Landmark_Groundtruth.dat": "# Subject x y sx sy\n 6 1.5 -2.5 0.1 0.1\n 7 3.0 4.0 0.1 0.1\n",
    "Robot1_Odometry.dat": "# Time v w\n100.000 0.1 0.0\n100.100 0.2 -0.3\n100.200 0.2 0.0\n",
    "Robot1_Measurement.dat": (
        "# Time barcode range bearing\n"
        "100.100 63 2.0 0.5\n"
        "100.100 25 3.0 -0.5\n"
        "100.100 14 1.0 0.0\n"  # another robot
        "100.150 99 1.0 0.0\n"  # in no table
        "100.150 45 1.0 0.0\n"  # a landmark that nobody surveyed
        "100.180 25 2.5 4.0\n"
    ),
    "Robot1_Groundtruth.dat": "# Time x y theta\n100.100 0.5 0.25 -1.0\n99.999999999 0.0 0.0 0.0\n",
}


def folder(root: Path, **changes: str | None) -> Path:
    """Write the small data set; ``changes`` replace tables (dots as two underscores) or leave them out."""
    changed = {name.replace("__", "."): text for name, text in changes.items()}
    for name, text in {**TABLES, **changed}.items():
        if text is not None:
            (root / name).write_text(text)
    return root


def problems(path: Path, robot: int | None = None) -> tuple[str, ...]:
    with pytest.raises(ImportFailedError) as caught:
        import_mrclam(path, robot)
    assert "\n".join(caught.value.problems) == str(caught.value)
    return caught.value.problems


def dropped(log: ImportedLog) -> Counter[str]:
    """Return how much a log leaves out, by reason."""
    return Counter({reason: lost.count for reason, lost in log.losses.summary().items()})


def counts(log: ImportedLog) -> Counter[str]:
    """Return how many records a log has, by topic."""
    return Counter(record.topic for record in log.records)


def test_records_come_in_time_order_with_everything_where_it_belongs(tmp_path: Path) -> None:
    log = import_mrclam(folder(tmp_path))
    assert log.records == (
        Record("log/truth", 99_999_999_999, RobotState(x=0.0, y=0.0, theta=0.0)),
        Record("log/odometry", 100_000_000_000, Odometry(v=0.1, w=0.0)),
        Record("log/truth", 100_100_000_000, RobotState(x=0.5, y=0.25, theta=-1.0)),
        Record("log/odometry", 100_100_000_000, Odometry(v=0.2, w=-0.3)),
        Record(
            "log/landmarks",
            100_100_000_000,
            LandmarkReadings(
                readings=(
                    LandmarkReading(landmark=6, range=2.0, bearing=0.5),
                    LandmarkReading(landmark=7, range=3.0, bearing=-0.5),
                )
            ),
        ),
        Record(
            "log/landmarks",
            100_180_000_000,
            LandmarkReadings(readings=(LandmarkReading(landmark=7, range=2.5, bearing=4.0 - math.tau),)),
        ),
        Record("log/odometry", 100_200_000_000, Odometry(v=0.2, w=0.0)),
    )
    assert landmarks_of(log.attachments) == (Landmark(id=6, x=1.5, y=-2.5), Landmark(id=7, x=3.0, y=4.0))


def test_the_log_counts_what_was_taken_and_what_was_dropped_and_why(tmp_path: Path) -> None:
    log = import_mrclam(folder(tmp_path))
    assert (log.settings["robot"], log.settings["landmarks"], log.settings["landmark_readings"]) == (1, 2, 3)
    assert counts(log) == {"log/odometry": 3, "log/landmarks": 2, "log/truth": 2}
    assert dropped(log) == {ROBOTS: 1, BARCODES: 1, UNMAPPED: 1}
    assert log.settings["reference_gaps_s"] == log.settings["heading_faults_s"] == []


def test_rows_whose_clock_goes_backwards_are_put_in_order_and_counted(tmp_path: Path) -> None:
    log = import_mrclam(folder(tmp_path, Robot1_Odometry__dat="100.2 0.3 0\n100.0 0.1 0\n100.1 0.2 0\n"))
    speeds = [record.message.v for record in log.records if isinstance(record.message, Odometry)]
    assert speeds == [0.1, 0.2, 0.3]
    assert log.settings["clock_backwards"] == 2  # that of the odometry, and of the reference


def test_other_robots_are_landmarks_that_move_where_their_reference_has_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = "100.100 14 1.0 0.0\n100.150 14 1.0 0.1\n100.900 14 1.0 0.1\n102.0 14 1.0 0.1\n100.180 25 2.5 4.0\n"
    paths = {f"Robot{robot}_Groundtruth__dat": "100.0 0 0 0\n" for robot in (3, 4, 5)}
    paths["Robot2_Groundtruth__dat"] = "100.1 1.0 2.0 0\n100.2 3.0 1.0 0\n101.0 5.0 5.0 0\n"
    source = folder(tmp_path, Robot1_Measurement__dat=seen, **paths)
    log = import_mrclam(source, 1, robots=True)
    found = [
        one for record in log.records if isinstance(record.message, LandmarkReadings) for one in record.message.readings
    ]
    assert found == [
        LandmarkReading(landmark=2, range=1.0, bearing=0.0, x=1.0, y=2.0),
        LandmarkReading(landmark=2, range=1.0, bearing=0.1, x=pytest.approx(2.0), y=pytest.approx(1.5)),  # type: ignore[arg-type]
        LandmarkReading(landmark=7, range=2.5, bearing=4.0 - math.tau),
    ]
    # In a gap of the other's reference, or after its end, nobody knows where it was.
    assert (log.settings["robot_readings"], dropped(log)[ROBOTS]) == (2, 2)
    assert dropped(import_mrclam(source, 1))[ROBOTS] == 4
    assert main(["import", "mrclam", str(source), "--robot", "1", "--robots", "-o", str(tmp_path / "log.mcap")]) == 0
    assert "robot readings: 2" in capsys.readouterr().out
    (source / "Robot3_Groundtruth.dat").unlink()
    with pytest.raises(ImportFailedError, match=r"Robot3_Groundtruth\.dat: no such file"):
        import_mrclam(source, 1, robots=True)


def test_a_gap_of_the_reference_is_told_in_seconds_from_the_start(tmp_path: Path) -> None:
    references = "100.0 0 0 0\n100.5 0 0 0\n101.1 0 0 0\n"
    log = import_mrclam(folder(tmp_path, Robot1_Groundtruth__dat=references))
    assert log.settings["reference_gaps_s"] == [pytest.approx((0.5, 1.1))]


def test_compressed_tables_and_a_single_robot_under_another_prefix_are_the_same_log(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    (tmp_path / "packed").mkdir()
    plain = import_mrclam(folder(tmp_path / "plain"))
    for name, text in TABLES.items():
        target = "ds1_" + name.replace("Robot1_", "")
        (tmp_path / "packed" / f"{target}.xz").write_bytes(lzma.compress(text.encode()))
    packed = import_mrclam(tmp_path / "packed")
    assert (packed.records, packed.attachments) == (plain.records, plain.attachments)
    assert packed.settings["robot"] is None
    (line,) = problems(tmp_path / "packed", robot=1)
    assert line.endswith("robot 1 asked for, but its one robot has no number; ask for none")


def test_a_robot_is_chosen_by_number(tmp_path: Path) -> None:
    other = {name.replace("Robot1", "Robot3"): text for name, text in TABLES.items() if "Robot1" in name}
    other["Robot3_Odometry.dat"] = "100.0 0.7 0.0\n"
    for name, text in other.items():
        (tmp_path / name).write_text(text)
    folder(tmp_path)
    assert counts(import_mrclam(tmp_path, 3))["log/odometry"] == 1
    assert counts(import_mrclam(tmp_path, 1))["log/odometry"] == 3
    assert problems(tmp_path) == (f"{tmp_path}: has robots 1, 3; choose one",)
    assert problems(tmp_path, 2) == (f"{tmp_path}: no robot 2; it has 1, 3",)


def test_a_marker_swap_is_told_in_the_summary_and_on_each_reference(tmp_path: Path) -> None:
    rows = [(100 + k / 20, 0.01 * k, 2.0 if 100 <= k < 300 else 0.0) for k in range(400)]
    references = "".join(f"{t:.3f} {x:.4f} 0.0 {theta}\n" for t, x, theta in rows)
    log = import_mrclam(folder(tmp_path, Robot1_Groundtruth__dat=references))
    assert log.settings["heading_faults_s"] == [pytest.approx((4.5, 15.5), abs=0.1)]
    poses = [record.message for record in log.records if isinstance(record.message, RobotState)]
    bad = [pose for pose in poses if not pose.heading_valid]
    assert len(bad) == pytest.approx(220, abs=3)
    assert all(pose.heading_valid for pose in poses if pose.x < 0.88 or pose.x > 3.12)


@pytest.mark.parametrize(
    ("table", "text", "expected"),
    [
        ("Robot1_Odometry", "100.0 abc 0.0\n", "Robot1_Odometry.dat:1: v is 'abc'; expected a finite number"),
        ("Robot1_Odometry", "# c\n\n100.0 0.1 nan\n", "Robot1_Odometry.dat:3: w is 'nan'; expected a finite number"),
        ("Robot1_Odometry", "100.0 0.1\n", "Robot1_Odometry.dat:1: 2 columns in '100.0 0.1'; expected 3"),
        (
            "Robot1_Odometry",
            "1 " * 99 + "\n",
            f"Robot1_Odometry.dat:1: over 9 columns in {'1 ' * 30!r}; expected 3",
        ),
        ("Robot1_Odometry", "-1 0 0\n", "Robot1_Odometry.dat:1: time is '-1'; expected seconds, 0 or more"),
        ("Robot1_Odometry", "inf 0 0\n", "Robot1_Odometry.dat:1: time is 'inf'; expected seconds, 0 or more"),
        ("Robot1_Odometry", "x 0 0\n", "Robot1_Odometry.dat:1: time is 'x'; expected seconds, 0 or more"),
        ("Robot1_Odometry", "# nothing\n", "Robot1_Odometry.dat: holds no record"),
        ("Robot1_Measurement", "1 63 -2 0\n", "Robot1_Measurement.dat:1: range is '-2'; expected 0 or more"),
        ("Robot1_Measurement", "1 6.5 2 0\n", "Robot1_Measurement.dat:1: barcode is '6.5'; expected a whole number"),
        (
            "Robot1_Groundtruth",
            "1 0 0 1e999\n",
            "Robot1_Groundtruth.dat:1: orientation is '1e999'; expected a finite number",
        ),
        ("Barcodes", "6 63\n7 63\n", "Barcodes.dat: barcode 63 has two subjects"),
        ("Barcodes", "#\n", "Barcodes.dat: holds no record"),
        ("Landmark_Groundtruth", "6 0 0 0 0\n6 1 1 0 0\n", "Landmark_Groundtruth.dat: subject 6 has two positions"),
        ("Landmark_Groundtruth", "6 a 0 0 0\n", "Landmark_Groundtruth.dat:1: x is 'a'; expected a finite number"),
    ],
)
def test_each_fault_of_a_table_is_one_line(tmp_path: Path, table: str, text: str, expected: str) -> None:
    assert problems(folder(tmp_path, **{f"{table}__dat": text})) == (expected,)


def test_all_faults_are_told_at_once_up_to_twenty(tmp_path: Path) -> None:
    bad = folder(tmp_path, Robot1_Odometry__dat="a 0 0\n" * 3, Robot1_Measurement__dat="b 63 1 0\n" * 30)
    with pytest.raises(ImportFailedError) as caught:
        import_mrclam(bad)
    assert len(caught.value.problems) == 33
    assert str(caught.value).splitlines()[-1] == "and 13 more"


def test_missing_and_unreadable_files_are_told_at_once(tmp_path: Path) -> None:
    path = folder(tmp_path, Barcodes__dat=None, Robot1_Measurement__dat=None)
    (path / "Robot1_Measurement.dat.xz").write_bytes(lzma.compress(b"x" * 1000)[:40])
    first, second = problems(path)
    assert first == f"{path / 'Barcodes.dat'}: no such file, nor Barcodes.dat.xz"
    assert second.startswith(f"{path / 'Robot1_Measurement.dat.xz'}: cannot be read beyond line 0: ")


@pytest.mark.parametrize("name", ["nowhere", "empty"])
def test_a_folder_without_a_data_set_is_told(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    (line,) = problems(tmp_path / name)
    assert line.startswith(f"{tmp_path / name}: no ")


def test_the_command_writes_every_record_in_order_and_prints_the_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, output = folder(tmp_path), tmp_path / "log.mcap"
    assert main(["import", "mrclam", str(source), "--robot", "1", "-o", str(output), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"]["landmark_readings"] == 3
    log, recording = import_mrclam(source, 1), read_recording(output)
    found = [Record(one.topic, one.stamp_ns, decode(one.topic, one.payload)) for one in recording.messages(node="log")]
    assert tuple(found) == log.records
    assert {(source.node, source.boot) for source in recording.sources} == {("log", "import")}
    (attached,) = recording.attachments
    assert attached.name == "landmarks.json"
    assert json.loads(attached.data) == [{"id": 6, "x": 1.5, "y": -2.5}, {"id": 7, "x": 3.0, "y": 4.0}]
    assert main(["doctor", str(output)]) == 0


def test_the_command_overwrites_nothing_and_tells_faults_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "log.mcap"
    output.write_bytes(b"kept")
    assert main(["import", "mrclam", str(folder(tmp_path)), "-o", str(output)]) == 2
    assert output.read_bytes() == b"kept"
    assert main(["import", "mrclam", str(tmp_path), "--robot", "4", "-o", str(tmp_path / "new.mcap")]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"dynpf import: {tmp_path}: no robot 4; it has 1"
    assert not (tmp_path / "new.mcap").exists()


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the MRCLAM data sets are not at {REAL}")
def test_the_real_slice_has_its_counts() -> None:
    log = import_mrclam(REAL / "ds1_seed_60s")
    assert (counts(log)["log/odometry"], counts(log)["log/truth"]) == (499, 5972)
    assert (log.settings["landmark_readings"], dropped(log)) == (216, {ROBOTS: 6})
    assert [landmark.id for landmark in landmarks_of(log.attachments)] == list(range(6, 21))
    assert log.settings["reference_gaps_s"] == log.settings["heading_faults_s"] == []
    stamps = [record.stamp_ns for record in log.records]
    assert stamps == sorted(stamps)


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the MRCLAM data sets are not at {REAL}")
def test_the_real_log_shows_its_two_marker_swaps_and_a_clean_one_none() -> None:
    log = import_mrclam(REAL / "ds1_Dataset9_Robot3")
    assert (counts(log)["log/odometry"], counts(log)["log/truth"]) == (11524, 125925)
    assert (log.settings["landmark_readings"], dropped(log)) == (5114, {ROBOTS: 6167 - 5114})
    assert len(log.settings["reference_gaps_s"]) == 9
    # The heading itself jumps at 757.5, 835.6, 991.2 and 1045.4 s; half a chord is added.
    assert log.settings["heading_faults_s"] == [
        pytest.approx((757.0, 836.1), abs=0.6),
        pytest.approx((991.2, 1046.0), abs=0.6),
    ]
    assert import_mrclam(REAL / "ds7_5robots_30s", 2).settings["heading_faults_s"] == []


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the MRCLAM data sets are not at {REAL}")
@pytest.mark.parametrize(
    ("name", "robot", "prefix", "common"),
    [
        ("ds1_Dataset9_Robot3", None, "ds1_", "ds1_"),
        ("ds1_seed_60s", None, "ds1_", "ds1_"),
        ("MRCLAM_Dataset7", 4, "Robot4_", ""),
        *(("ds7_5robots_30s", robot, f"Robot{robot}_", "") for robot in range(1, 6)),
    ],
)
def test_a_real_log_comes_over_row_by_row(name: str, robot: int | None, prefix: str, common: str) -> None:
    source = REAL / name
    log = import_mrclam(source, robot)
    odometry, seen, truth = (rows_of(source, f"{prefix}{what}") for what in ("Odometry", "Measurement", "Groundtruth"))
    subjects = {row[1]: int(row[0]) for row in rows_of(source, f"{common}Barcodes")}
    surveyed = {int(row[0]) for row in rows_of(source, f"{common}Landmark_Groundtruth")}
    found: dict[str, list[Record]] = {}
    for record in log.records:
        found.setdefault(record.topic, []).append(record)

    expected = [(nanoseconds(row[0]), Odometry(v=float(row[1]), w=float(row[2]))) for row in odometry]
    assert [(one.stamp_ns, one.message) for one in found["log/odometry"]] == expected
    poses = []
    for one in found["log/truth"]:
        assert isinstance(one.message, RobotState)
        poses.append((one.stamp_ns, one.message.x, one.message.y, one.message.theta))
    assert poses == [(nanoseconds(row[0]), *map(float, row[1:])) for row in truth]
    readings = []
    for one in found["log/landmarks"]:
        assert isinstance(one.message, LandmarkReadings)
        readings += [(one.stamp_ns, each.landmark, each.range, each.bearing) for each in one.message.readings]
    kept = [row for row in seen if subjects.get(row[1]) in surveyed]
    assert readings == [
        (nanoseconds(row[0]), subjects[row[1]], float(row[2]), math.remainder(float(row[3]), math.tau)) for row in kept
    ]
    assert len(seen) - len(kept) == dropped(log).total()
    assert dropped(log)[BARCODES] == sum(row[1] not in subjects for row in seen)
    stamps = [nanoseconds(row[0]) for rows in (odometry, kept, truth) for row in (rows[0], rows[-1])]
    first, *_, last = log.records
    assert (first.stamp_ns, last.stamp_ns) == (min(stamps), max(stamps))


def rows_of(folder: Path, name: str) -> list[list[str]]:
    path = folder / f"{name}.dat"
    text = path.read_text() if path.exists() else lzma.decompress((folder / f"{name}.dat.xz").read_bytes()).decode()
    return [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]


def nanoseconds(text: str) -> int:
    whole, _, part = text.partition(".")
    return int(whole) * 10**9 + int(part.ljust(9, "0")[:9])
