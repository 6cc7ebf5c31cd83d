"""What ``dynpf export`` writes: trajectories for evo, tables with nothing lost, and refusals in one line."""

import csv
import json
import math
import sys
from pathlib import Path

import pytest
from dynpf_formats.exporters.table import columns
from dynpf_formats.exporters.trajectory import tum_lines
from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.messages import Estimate, RobotState
from evo.tools import file_interface
from mcap.records import Channel, Message

from checks.fuzz.anatomy import Anatomy
from tests.unit.recording.recorded_runs import lockstep, write

S = 1_700_000_000
LOG = f"""\
FLASER 2 1.25 90.0 1 2 0.5 1 2 0.5 {S}.123456789 h 1
FLASER 2 1.5 2.5 1.5 2 -3.0 1.5 2 -3.0 {S}.5 h 2
ODOM 1.75 2 0.1 0 0 0 {S}.25 h 3
ODOM 1.5 2 7.0 0 0 0 {S}.25 h 3
TRUEPOS 3 4 0.1 0 0 0 {S}.25 h 3
"""


@pytest.fixture(name="log")
def imported(tmp_path: Path) -> Path:
    source, output = tmp_path / "log.txt", tmp_path / "log.mcap"
    source.write_text(LOG)
    assert main(["import", "carmen", str(source), "-o", str(output)]) == 0
    return output


def test_a_trajectory_is_in_order_of_time_one_pose_each_with_all_nanoseconds(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "odometry.tum"
    words = ["export", str(log), "--format", "tum", "--topic", "log/odometry_pose", "-o", str(output)]
    assert main(words) == 0
    assert capsys.readouterr().err == f"1 of log/odometry_pose written to {output}\n"
    (line,) = output.read_text().splitlines()
    stamp, *numbers = line.split()
    assert stamp == f"{S}.250000000"
    x, y, z, qx, qy, qz, qw = map(float, numbers)
    assert (x, y, z, qx, qy) == (1.5, 2.0, 0.0, 0.0, 0.0)
    assert 2 * math.atan2(qz, qw) == pytest.approx(7.0 - math.tau)


def test_the_reference_is_what_is_exported_of_a_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["export", str(log), "--format", "tum"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{S}.250000000 3.0 4.0 0.0 ")
    assert err == "1 of log/truth written to standard output\n"


def test_a_table_has_every_field_of_every_message(log: Path, tmp_path: Path) -> None:
    output = tmp_path / "scans.csv"
    assert main(["export", str(log), "--format", "csv", "--topic", "log/scan", "-o", str(output)]) == 0
    with output.open(newline="") as stream:
        first, second = csv.DictReader(stream)
    assert (first["stamp_ns"], first["sequence"]) == (f"{S}123456789", "0")
    assert json.loads(first["ranges"]) == [1.25, 80.0]
    assert json.loads(second["ranges"]) == [1.5, 2.5]
    assert float(first["start_angle"]) == -math.pi / 2
    assert first["frame_id"] == "robot"


def test_parquet_holds_the_same_table(log: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the package pyarrow is not installed")
    output = tmp_path / "scans.parquet"
    assert main(["export", str(log), "--format", "parquet", "--topic", "log/scan", "-o", str(output)]) == 0
    table = parquet.read_table(output).to_pylist()
    assert [row["ranges"] for row in table] == [[1.25, 80.0], [1.5, 2.5]]
    assert [row["stamp_ns"] for row in table] == [S * 10**9 + 123456789, S * 10**9 + 500000000]
    assert table[0]["pose.orientation.w"] == 1.0


def test_lists_of_a_fixed_length_have_a_column_for_each_place(log: Path) -> None:
    estimate = Estimate(x=1.0, y=2.0, theta=0.5, covariance=tuple(map(float, range(9))), n_eff=7.0)
    found = {name: get(estimate) for name, (_, get) in columns(read_recording(log), "estimator/state").items()}
    assert {name: value for name, value in found.items() if not name.startswith("health")} == {
        "x": 1.0,
        "y": 2.0,
        "theta": 0.5,
        **{f"covariance.{place}": float(place) for place in range(9)},
        "n_eff": 7.0,
    }
    assert {value for name, value in found.items() if name.startswith("health")} == {None}  # which it leaves out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--format", "tum", "--topic", "log/scan"], "log/scan holds no poses; those of this recording with poses: "),
        (["--format", "csv", "--topic", "estimator/state"], "nothing on estimator/state; it has log/odometry_pose, "),
        (["--format", "parquet"], "--format parquet needs -o FILE"),
        (["--format", "csv", "-o", "{log}"], "the file exists; choose another name"),
        (["--format", "csv", "-o", "{log}/x"], "cannot be written: "),
    ],
)
def test_what_cannot_be_exported_is_told_in_one_line(
    log: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    before = log.read_bytes()
    capsys.readouterr()
    assert main(["export", str(log), *(word.format(log=log) for word in words)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dynpf export: ")
    assert told in line
    assert log.read_bytes() == before


def test_a_number_that_no_table_holds_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    anatomy = Anatomy.of(write(tmp_path / "run.mcap", lockstep(3)).read_bytes())
    topic = next(iter(anatomy.of_type(Channel))).topic
    for message in anatomy.of_type(Message):
        message.log_time = 2**63
    (tmp_path / "late.mcap").write_bytes(anatomy.bytes())
    words = ["--format", "parquet", "--topic", topic, "-o", str(tmp_path / "late.parquet")]
    assert main(["export", str(tmp_path / "late.mcap"), *words]) == 2
    assert f"late.mcap: {topic}: a whole number of 2^63 or more" in capsys.readouterr().err


def test_missing_packages_are_named_with_what_to_install(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("dynpf_formats.exporters.parquet", "dynpf_formats.importers.rosbag", "dynpf_formats.importers.bags"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in ("pyarrow", "rosbags"):
        for loaded in [one for one in sys.modules if one.partition(".")[0] == name]:
            monkeypatch.delitem(sys.modules, loaded)
        monkeypatch.setitem(sys.modules, name, None)
    capsys.readouterr()
    assert main(["export", str(log), "--format", "parquet", "-o", str(tmp_path / "x")]) == 2
    assert main(["import", "rosbag", str(log), "-o", str(tmp_path / "y")]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "dynpf export: writing Parquet needs the package pyarrow: pip install 'dynpf-lab[parquet]'",
        "dynpf import: reading ROS bags needs the package rosbags: pip install 'dynpf-lab[ros]'",
    ]


def test_evo_reads_a_trajectory(log: Path, tmp_path: Path) -> None:
    output = tmp_path / "truth.tum"
    assert main(["export", str(log), "--format", "tum", "-o", str(output)]) == 0
    trajectory = file_interface.read_tum_trajectory_file(str(output))
    assert trajectory.check()[0]
    assert trajectory.positions_xyz.tolist() == [[3.0, 4.0, 0.0]]
    assert heading_of(trajectory.orientations_quat_wxyz[0]) == pytest.approx(0.1)


def heading_of(wxyz: list[float]) -> float:
    return 2.0 * math.atan2(wxyz[3], wxyz[0])


def test_exporting_and_importing_a_reference_gives_it_back(log: Path, tmp_path: Path) -> None:
    text, back = tmp_path / "truth.tum", tmp_path / "back.mcap"
    assert main(["export", str(log), "--format", "tum", "-o", str(text)]) == 0
    assert main(["import", "tum", str(text), "-o", str(back)]) == 0
    (before,), (after,) = text.read_text().splitlines(), tum_lines(read_recording(back), "log/truth")
    assert after.split()[0] == before.split()[0]
    assert [float(one) for one in after.split()] == pytest.approx([float(one) for one in before.split()], abs=1e-15)


def test_of_estimates_of_one_stamp_that_which_follows_the_reference_is_meant(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    header = RunHeader(scenario="{}", seed=1, provenance=collect())
    sent = [
        ("estimator/state", 7, 1.0),
        ("log/truth", 7, 0.0),
        ("estimator/state", 6, 2.0),
        ("estimator/state", 7, 3.0),
    ]
    sent += [("estimator/state", 6, 4.0), ("estimator/state", 7, 5.0)]  # the clock has jumped back
    with RecordingWriter(path, header) as writer:
        for place, (topic, stamp_ns, x) in enumerate(sent):
            sequence = sum(one[0] == topic for one in sent[:place])
            message = (
                RobotState(x=x, y=0.0, theta=0.0)
                if topic == "log/truth"
                else Estimate(x=x, y=0.0, theta=0.0, covariance=(1.0,) * 9, n_eff=1.0)
            )
            node = "log" if topic == "log/truth" else "estimator"
            writer.message(topic, Envelope(node, "b", sequence, 0, stamp_ns, 0), encode(topic, message))
        writer.close(complete=True, reason="done")
    recording = read_recording(path)
    assert [line.split()[:2] for line in tum_lines(recording, "estimator/state")] == [
        ["0.000000006", "4.0"],
        ["0.000000007", "3.0"],
    ]
    assert [line.split()[:2] for line in tum_lines(recording, "log/truth")] == [["0.000000007", "0.0"]]
