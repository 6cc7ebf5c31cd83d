"""The measures of a recorded run: what its truth names and its scenario does not have is left out."""

import math
from pathlib import Path

import pytest
from dynpf_experiments.messages import RunMessages, Timed
from dynpf_experiments.messages import recorded as messages_of
from dynpf_formats.recording.reader import read_recording
from dynpf_systems.colon.measures import capsule, radius_error
from dynpf_systems.colon.messages import CapsuleState
from msgspec.structs import replace

REFERENCE = Path(__file__).parents[3] / "recordings" / "colon.mcap"


def in_map(run: RunMessages, name: str) -> RunMessages:
    def read(topic: str) -> list[Timed]:
        messages = run.topic(topic)
        return [
            timed._replace(message=replace(timed.message, map=name))
            if isinstance(timed.message, CapsuleState)
            else timed
            for timed in messages
        ]

    return RunMessages(lambda: run.scenario, run.with_files, read, run.topics)


def test_a_truth_in_an_unknown_map_is_measured_by_its_pose_alone() -> None:
    run = messages_of(read_recording(REFERENCE))
    known = capsule(run)
    assert "posterior_truth" in known
    unknown = capsule(in_map(run, "nowhere"))
    assert "posterior_truth" not in unknown
    assert unknown["error_position_px"] == known["error_position_px"]


@pytest.mark.parametrize(("name", "percent"), [("end 100", 5.0), ("end 52.5", 100.0)])
def test_the_radius_is_that_in_the_maps_name(name: str, percent: float) -> None:
    assert radius_error(105.0, name) == pytest.approx(percent)


@pytest.mark.parametrize("name", ["end", "end x", "end 0", "end 1e999", "rest"])
def test_a_name_without_a_radius_has_no_error(name: str) -> None:
    assert math.isnan(radius_error(105.0, name))
