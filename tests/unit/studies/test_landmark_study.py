"""The study of LANDMARK: its runs are the scenario's, its starts differ, its rows are as scripts expect."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from dynpf_formats.importers.log import Record
from dynpf_lab.cli.main import main
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, Odometry
from dynpf_systems.rooms.studies.landmark_logs import (
    every_second_landmark,
    nearest_past,
    opened,
    stretches,
    withheld,
)

DATA = Path(__file__).parents[3] / "../shared/data/mrclam"
MINUTE = DATA / "ds1_seed_60s"
real = pytest.mark.skipif(not MINUTE.is_dir(), reason=f"the MRCLAM data sets are not at {DATA}")


def readings(stamp: int, *landmarks: int) -> Record:
    found = tuple(LandmarkReading(landmark=one, range=1.0, bearing=0.0) for one in landmarks)
    return Record("log/landmarks", stamp, LandmarkReadings(readings=found))


def odometry(stamp: int) -> Record:
    return Record("log/odometry", stamp, Odometry(v=0.0, w=0.0))


def told(records: Sequence[Record]) -> list[object]:
    """Each record as its stamp or, with readings, stamp and landmarks."""
    return [
        (one.stamp_ns, *(reading.landmark for reading in one.message.readings))
        if isinstance(one.message, LandmarkReadings)
        else one.stamp_ns
        for one in records
    ]


RECORDS = [odometry(1), readings(2, 6, 7), readings(3, 9), odometry(4), odometry(5), readings(6, 8, 9, 10)]


def test_what_is_withheld_and_dropped_and_paired() -> None:
    assert told(withheld(4)(RECORDS)) == [1, 4, 5, (6, 9, 10)]
    assert told(withheld(0)(RECORDS)) == told(RECORDS)
    assert told(every_second_landmark(RECORDS)) == [1, (2, 6), 4, 5, (6, 8, 10)]
    assert told(nearest_past(RECORDS)) == [1, 4, (4, 9), 5]


@real
def test_each_trial_starts_at_another_place_whose_reference_is_good() -> None:
    log = opened(str(DATA / "ds1_Dataset9_Robot3"), None)
    ways = stretches(log, 20, 300.0)
    assert [way.first for way in ways] == pytest.approx([k * 1087.0 / 20 for k in range(20)], abs=160.0)
    assert len({way.pose for way in ways}) == 20
    for way in ways:
        assert not 757.0 < way.first < 834.0
        assert not 991.5 < way.first < 1045.0
        place = np.flatnonzero(np.isclose(log.truth.stamps, way.first + log.start_ns * 1e-9, rtol=0.0, atol=1e-6))[0]
        assert log.heading_valid[place]
        assert tuple(log.truth.poses[:, place]) == way.pose


@real
def test_rows_have_the_names_that_scripts_hold_on_to(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the package matplotlib is not installed")
    chosen = {
        "data": [str(MINUTE)],
        "experiments": ["expectations", "particles", "filters", "unknown", "withheld"],
        "n": [10, 50],
        "filters": ["sir", "extended_kalman"],
        "filters_n": 50,
        "seconds": 12.0,
        "withheld": 5,
        "unknown_trials": 1,
    }
    words = [word for key, value in chosen.items() for word in ("--set", f"{key}={value}")]
    assert main(["study", "landmark", "--trials", "2", "--jobs", "1", "--json", "-o", str(tmp_path), *words]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["study"] == "landmark"
    rows = {
        (row["experiment"], row["filter"], row["n"], row["start"], row["readings"]): row for row in document["rows"]
    }
    assert {row["dataset"] for row in document["rows"]} == {"ds1_seed_60s"}
    kept = rows["particles", "sir", 50, "known", "all"]
    assert kept["trials"] == 2
    assert 0.0 < kept["position_rmse_m_mean"] < 0.3
    assert {"position_rmse_m_median", "position_rmse_m_p95", "heading_rmse_rad_mean"} <= kept.keys()
    assert ("filters", "dead_reckoning", 0, "known", "all") in rows
    assert rows["unknown", "sir", 50, "unknown", "all"].keys() >= {"success_percent", "success_percent_ci_low"}
    assert rows["withheld", "sir", 50, "known", "first 5 withheld"]["recovered_percent"] in (0.0, 50.0, 100.0)
    thirteen = rows["expectations", "", 0, "(0.0, 3.0, 0.0)", "landmark 13"]
    assert thirteen["expected_range_m_mean"] == pytest.approx(thirteen["printed_range_m"], abs=1e-6)
    assert thirteen["expected_bearing_rad_mean"] == pytest.approx(-0.729016, abs=1e-6)  # not what is printed
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".csv", ".html", ".png"}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--set", "data=['nowhere']"], "--set data=nowhere: not there"),
        (["--set", "filters=['sirr']"], "filters has 'sirr'; expected some of extended_kalman"),
        (["--set", "n=0"], "settings of this study: data"),
    ],
)
def test_what_cannot_be_studied_is_told_in_one_line(
    capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    assert main(["study", "landmark", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line
