"""What a scanner says of itself reaches the filter as any other input; without it, scans are left out with a word."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.messages import LaserScan, Log, Message, Scanner, planar_pose, timestamp
from dynpf_runtime.node import Received, Result, Step, decode_state, encode_state
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.estimator import LocalizationEstimator
from dynpf_systems.rooms.maps import Maps

from dynpf.filters.start import KnownStart
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.beam import BeamParams
from dynpf.measurement.position import GaussianPositionParams

TOPICS = {Scanner: "sensors/scanner", LaserScan: "sensors/scan"}
BEAM = BeamParams()
FREE = OccupancyGrid(np.full((80, 80), 0, dtype=np.uint8), 0.1, (-4.0, -4.0, 0.0))
SCAN = LaserScan(
    timestamp=timestamp(0),
    frame_id="robot",
    pose=planar_pose(0.0, 0.0, 0.0),
    start_angle=-1.0,
    end_angle=1.0,
    ranges=(8.0,) * 5,
)
"""Of a scanner that measures up to 8 m, in a hall without walls: no beam returns."""


def estimator(measurement: Any = BEAM, **config: Any) -> LocalizationEstimator:
    start = KnownStart(x=0.0, y=0.0, theta=0.0, sigma_position=0.5)
    whole = LocalizationConfig(n=50, start=start, measurement=(measurement,), **config)
    return LocalizationEstimator(config=whole, seed=1, maps=Maps(grid=FREE), classes={})


def stepped(node: LocalizationEstimator, number: int, *messages: Message) -> Result:
    stamp = number * 10**9
    inputs = tuple(Received(TOPICS[type(m)], "sensors", "boot", number, stamp, m) for m in messages)
    return node.step(Step(number, number, stamp, inputs))


def warnings(result: Result) -> list[str]:
    found = (output.message for output in result.outputs if isinstance(output.message, Log))
    return [message.message for message in found if message.level >= 3]


def used(node: LocalizationEstimator) -> int:
    count: int = node.freeze()["outcomes"]["used"]
    return count


def test_a_scan_without_a_scanner_is_left_out_and_told_once_and_the_next_with_one_is_used() -> None:
    node = estimator()
    (warning,) = warnings(stepped(node, 0, SCAN))
    assert "sensors/scan: left out as long as no message on sensors/scanner has come" in warning
    assert "set estimator.scan_range_max, import the log again" in warning
    assert warnings(stepped(node, 1, SCAN)) == []
    assert used(node) == 0
    assert warnings(stepped(node, 2, Scanner(range_max=8.0), SCAN)) == []
    assert used(node) == 1
    stepped(node, 3, SCAN)
    assert used(node) == 2


def test_what_the_scenario_says_stands_against_the_scanner_and_in_its_place() -> None:
    likely = [
        stepped(estimator(), 0, Scanner(range_max=8.0), SCAN),
        stepped(estimator(scan_range_max=8.0), 0, SCAN),
        stepped(estimator(scan_range_max=8.0), 0, Scanner(range_max=20.0), SCAN),
    ]
    unlikely = stepped(estimator(), 0, Scanner(range_max=20.0), SCAN)  # beams that end where there is nothing
    assert len({str(result.outputs[0].message) for result in likely}) == 1
    assert unlikely.outputs[0].message != likely[0].outputs[0].message


def test_a_scanner_that_changes_is_believed_from_then_on() -> None:
    changed, fixed = estimator(), estimator()
    for node, range_max in ((changed, 20.0), (fixed, 8.0)):
        stepped(node, 0, Scanner(range_max=range_max))
        stepped(node, 1, Scanner(range_max=8.0))
    assert stepped(changed, 2, SCAN) == stepped(fixed, 2, SCAN)


@pytest.mark.parametrize("told", [True, False])
def test_what_was_said_and_warned_of_is_part_of_the_state(told: bool) -> None:
    node, thawed = estimator(), estimator()
    stepped(node, 0, *([Scanner(range_max=8.0)] if told else []), SCAN)
    thawed.thaw(decode_state(encode_state(node.freeze())))
    assert stepped(thawed, 1, SCAN) == stepped(node, 1, SCAN)
    assert used(thawed) == 2 * told


def test_a_filter_that_takes_no_scans_goes_on_whatever_the_scenario_says_of_them() -> None:
    node, thawed = (estimator(GaussianPositionParams(), scan_range_max=8.0) for _ in range(2))
    assert warnings(stepped(node, 0, Scanner(range_max=20.0), SCAN)) == []
    thawed.thaw(decode_state(encode_state(node.freeze())))
    assert encode_state(thawed.freeze()) == encode_state(node.freeze())


def test_a_simulated_scanner_and_the_estimator_need_no_word_of_the_scenario(tmp_path: Path) -> None:
    record_inline(load_scenario("room-scan", overrides=["max_ticks=6"]), tmp_path / "run.mcap")
    recording = read_recording(tmp_path / "run.mcap")
    assert [one.payload for one in recording.messages("sensors/scanner")] == [b'{"range_min":0.0,"range_max":5.0}']
    (boot,) = recording.boots("estimator")
    consumed = [one.topic for entry in recording.journal("estimator", boot) for one in entry.consumed]
    assert consumed.count("sensors/scanner") == 1
    assert not [one for one in recording.messages("notice") if b"sensors/scanner" in one.payload]
