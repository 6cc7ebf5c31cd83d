"""The story of a run: its verdicts with what changed, and what happened at the time."""

from collections.abc import Sequence

import msgspec
import pytest
from dynpf_experiments.explanation import as_data, explanation, in_words
from dynpf_experiments.pictures.changes import changed
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.notebook import run
from dynpf_protocol.messages import HealthFigures

from tests.unit.page.runs import recorded, short_run

CARRIED_TICK = 30


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A robot that is carried off in mid-run."""
    path = tmp_path_factory.mktemp("explained") / "carried.mcap"
    settings = {
        "max_ticks": 100,
        "simulator.kidnappings": [{"tick": CARRIED_TICK, "to": [1.0, 1.0, -2.4]}],
        "estimator.health": {"worse_after": 1},
    }
    run("landmark-room", settings=settings, path=path)
    return read_recording(path)


def test_the_story_tells_when_the_robot_was_carried_off_and_what_the_filter_made_of_it(carried: Recording) -> None:
    story = explanation(carried)
    (leap,) = [event for event in story.events if event.kind == "leap"]
    assert leap.node == "truth/robot"
    assert leap.seconds == pytest.approx(0.1 * CARRIED_TICK)
    first, *later = story.verdicts
    assert (first.status, first.begin) == ("tracking", 0.0)
    assert first.error_m is not None
    assert first.error_m < 0.2
    noticed = next(verdict for verdict in later if verdict.status != "tracking")
    assert leap.seconds <= noticed.begin <= leap.seconds + 2.0
    assert "not believed" in noticed.changed
    lines = in_words(story)
    assert next(line for line in lines if "elsewhere within 0.1 s" in line).startswith("      3.0 s  truth/robot: ")
    assert sum(story.shares["estimator"].values()) == pytest.approx(1.0)
    assert msgspec.json.decode(msgspec.json.encode(as_data(story)))["verdicts"][0]["status"] == "tracking"


def test_an_undisturbed_run_has_one_verdict_and_its_end() -> None:
    story = explanation(short_run("landmark-room", 60))
    assert [verdict.status for verdict in story.verdicts] == ["tracking"]
    assert [event.kind for event in story.events] == ["end"]


def test_a_run_whose_filter_says_nothing_of_itself_says_so() -> None:
    story = explanation(recorded("colon"))
    assert not story.verdicts
    assert "no node of this run says" in in_words(story)[1]


@pytest.mark.parametrize(
    ("before", "now", "told"),
    [
        ([0.1, 0.1, 5.0], 0.19, ""),
        ([0.1, 0.1, 5.0], 0.21, "standard deviation of the position 0.1 -> 0.21 m"),
        ([0.1], 0.049, "standard deviation of the position 0.1 -> 0.049 m"),
        ([], 0.2, ""),
    ],
)
def test_what_changed_is_measured_by_the_median_before(before: Sequence[float], now: float, told: str) -> None:
    figures = [HealthFigures(position_sigma=value) for value in before]
    assert changed(figures, HealthFigures(position_sigma=now)) == told
    assert not changed(figures, HealthFigures())
