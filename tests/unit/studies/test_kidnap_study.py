"""The study of lost robots: how a robot is carried off, what counts as found, and a short stretch of a real log."""

import math
from pathlib import Path

import numpy as np
import pytest
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.mapping import drawn_map
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import LaserScan, OdometryPose
from dynpf_services.scenario.schema import LogFacts
from dynpf_systems.rooms.studies import kidnap, laser_logs
from dynpf_systems.rooms.studies.kidnap import STUDY, KidnapSettings, Task, run_task, tasks
from dynpf_systems.rooms.studies.laser_logs import LaserLog, Record, imported_log, split
from dynpf_systems.rooms.studies.laser_runs import Moment, kidnapped

from dynpf.se2 import compose, relative

SLICE = Path(__file__).parents[3] / "../shared/data/carmen/intel_30-150s.log"
CARRIED_M = 2.0


def moment(error: float, updates: int, status: str = "tracking") -> Moment:
    return Moment(np.zeros(3), np.array([error, 0.0, 0.0]), np.eye(3), status, updates)


def test_it_is_found_from_the_first_of_five_scans_that_are_near_if_it_is_near_at_the_end() -> None:
    lucky = [moment(0.1, 0), moment(3.0, 1)]
    settled = [moment(0.1, k) for k in range(2, 9)]
    assert kidnap._found([*lucky, *settled], 100, 0) == 2.0
    assert math.isnan(kidnap._found([*lucky, *settled], 1, 0))
    assert math.isnan(kidnap._found([*lucky, *settled, moment(3.0, 9)], 100, 0))
    turned = [one._replace(estimate=np.array([0.0, 0.0, 0.5])) for one in settled]
    assert math.isnan(kidnap._found(turned, 100, 0))


def test_the_verdict_is_told_with_its_delay() -> None:
    assert kidnap._detected([moment(3.0, 7), moment(3.0, 8, "uncertain"), moment(3.0, 9, "lost")], 6) == 3.0
    assert math.isnan(kidnap._detected([moment(3.0, 7)], 6))


@pytest.fixture(scope="module", name="log")
def slice_of_intel() -> LaserLog:
    if not SLICE.is_file():
        pytest.skip(f"the log is not at {SLICE}")
    drawn = drawn_map(lambda: import_carmen(SLICE).records, 0.05, "map")
    return imported_log("slice", import_carmen(SLICE, attachments=drawn))


def test_odometry_tells_nothing_of_the_way_that_is_withheld(log: LaserLog) -> None:
    at = log.scans[10]
    left = kidnapped(log.records, at, CARRIED_M)
    before, after = log.records[at].truth, left[at].truth
    assert before is not None
    assert after is not None
    away = math.dist(before[:2], after[:2])
    assert CARRIED_M < away < CARRIED_M + 1.5
    assert isinstance(left[at].message, LaserScan)
    assert left[:at] == list(log.records[:at])
    # Steps after it are those of the log, and the first of them begins where odometry was before it.
    poses = [
        (k, np.array([m.x, m.y, m.theta]))
        for k, m in enumerate(record.message for record in left)
        if isinstance(m, OdometryPose)
    ]
    told = {one.number: one.message for one in log.records if isinstance(one.message, OdometryPose)}
    numbers = [left[k].number for k, _ in poses]
    first = next(k for k, (place, _) in enumerate(poses) if place > at)
    original = [np.array([told[n].x, told[n].y, told[n].theta]) for n in numbers]
    for k in range(first + 1, len(poses)):
        step = relative(original[k - 1], original[k])
        np.testing.assert_allclose(compose(poses[k - 1][1], step)[:2], poses[k][1][:2], atol=1e-9)
    assert math.dist(poses[first - 1][1][:2], poses[first][1][:2]) < 0.3
    with pytest.raises(ValueError, match="does not get"):
        kidnapped(log.records, at, 1e3)


def test_a_split_log_has_half_of_the_scans_and_a_map_of_the_others(log: LaserLog) -> None:
    half = split(log)
    assert len(half.scans) == len(log.scans) // 2
    assert [one.number for one in half.records if one.truth] == [log.records[k].number for k in log.scans[1::2]]
    assert half.facts.files["map.pgm"] != log.facts.files["map.pgm"]


def test_a_robot_is_found_on_a_stretch_of_a_real_log(log: LaserLog, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kidnap, "log_named", lambda _: log)
    monkeypatch.setattr(kidnap, "REST", 8)
    settings = KidnapSettings(logs=("slice",), kidnapped_m=CARRIED_M, lead=12)
    (found,) = run_task(Task("slice", "global", 2000, "relocation", "search", settings, 1))
    assert found.measures == {"success_percent": True, "updates_to_converge": 1.0}
    (carried,) = run_task(Task("slice", "kidnapped", 2000, "relocation", "known", settings, 2))
    assert carried.measures["recovered_percent"]
    assert 5.0 <= carried.measures["updates_to_recover"] <= 8.0  # a place has to explain five scans
    assert carried.measures["detected_percent"]
    assert not carried.measures["false_alarm_percent"]
    # Without jumps the robot stays lost.
    (stays,) = run_task(Task("slice", "kidnapped", 2000, "sir", "known", settings, 2))
    assert not stays.measures["recovered_percent"]


def test_rows_name_what_scripts_read(monkeypatch: pytest.MonkeyPatch) -> None:
    study = STUDY
    monkeypatch.setattr(kidnap, "log_named", lambda name: LaserLog(name, (), LogFacts("", [])))
    parts = tasks(KidnapSettings(logs=("a", "b"), filters=("relocation", "sir"), tracking_trials=1), 4, 7)
    assert len(parts) == 2 * 2 * (1 + 4 + 4)
    assert {one.seed for one in parts} == {7, 8, 9, 10}
    assert {one.start for one in parts} == {"known", "search"}
    assert study.trials == 20


def test_a_log_that_is_absent_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    laser_logs.log_named.cache_clear()
    monkeypatch.delenv("DYNPF_DATA", raising=False)
    with pytest.raises(UsageError, match=r"logs: intel is read from a folder of data: name it by --data FOLDER"):
        laser_logs.log_named("intel")
    monkeypatch.setenv("DYNPF_DATA", str(tmp_path))
    with pytest.raises(UsageError, match=r"logs: intel is read from .*intel-corrected.log.gz, which is not there"):
        laser_logs.log_named("intel")
    with pytest.raises(UsageError, match="neither a file nor one of intel, "):
        laser_logs.log_named("nowhere.mcap")


def test_only_a_scan_of_known_place_can_be_where_it_is_carried_off() -> None:
    one = Record(3, "log/scan", 5, OdometryPose(x=0.0, y=0.0, theta=0.0), None)
    with pytest.raises(ValueError, match="record 0 is not a scan"):
        kidnapped([one], 0, 1.0)
