"""Frames of a run that goes on show what the page of its recording shows at that moment."""

from pathlib import Path

import pytest
from dynpf_experiments.pictures.live import LiveRun
from dynpf_experiments.pictures.source import Budget
from dynpf_experiments.pictures.whole import whole
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.live.document import live_document
from dynpf_protocol.envelope import Envelope
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline


@pytest.fixture(name="recordings", scope="module")
def some_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    folder = tmp_path_factory.mktemp("runs")
    for name in ("landmark-room", "parts-3-easy", "colon-case-1"):
        record_inline(load_scenario(name, overrides=["max_ticks=40"]), folder / f"{name}.mcap")
    return {path.stem: read_recording(path) for path in sorted(folder.glob("*.mcap"))}


@pytest.mark.parametrize("name", ["landmark-room", "parts-3-easy", "colon-case-1"])
def test_the_last_frame_is_the_end_of_the_page(recordings: dict[str, Recording], name: str) -> None:
    recording = recordings[name]
    scenario = load_scenario(name, overrides=["max_ticks=40"])
    live = LiveRun(scenario, plan_of(scenario))
    for record in recording.messages():
        tick = recording.tick_of(record) or 0
        envelope = Envelope(record.node, record.boot, record.sequence, tick, record.stamp_ns, 0)
        live.hear(record.topic, envelope, record.payload)
        if record.topic.startswith("truth/") and record.sequence % 7 == 0:
            live.frame()  # whatever was shown before
    moving, staying = live.frame()
    run = whole(recording, Budget())
    assert moving["t"] == round(run.seconds, 3)
    last = {(each.name, each.role): each.poses[:, -1].tolist() for each in run.tracks if each.role != "odometry"}
    shown = {(each["name"], each["role"]): each for each in moving["tracks"]}
    assert last.keys() <= shown.keys()
    for key, (x, y, _) in last.items():
        found = [sum(step or 0 for step in shown[key][axis]["d"]) * shown[key][axis]["q"] for axis in "xy"]
        assert found == pytest.approx([x, y], abs=2e-4)
    assert staying["unit"] == run.drawing.unit.name
    assert len(staying["shapes"]) >= len(run.drawing.shapes) > 0
    assert [each["key"] for each in moving["plots"]] == [plot.key for plot in run.plots if plot.lines]


def test_the_page_loads_nothing_from_elsewhere_and_escapes_its_title() -> None:
    html, policy = live_document("<b>&", ["seed 1"], may_act=True)
    assert "&lt;b&gt;&amp;" in html
    assert "<b>&" not in html
    assert "connect-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http://" not in html.replace("http://www.w3.org/", "")


def test_whoever_may_not_act_sees_no_hands() -> None:
    marked = 'data-act="drive move place body door map" hidden'
    assert [marked in live_document("t", [], may_act=may_act)[0] for may_act in (True, False)] == [False, True]


def test_a_frame_of_nothing_is_a_frame(tmp_path: Path) -> None:
    scenario = load_scenario("landmark-room")
    moving, staying = LiveRun(scenario, plan_of(scenario)).frame()
    assert (moving["t"], moving["tick"], moving["tracks"]) == (0.0, -1, [])
    assert staying["shapes"]
