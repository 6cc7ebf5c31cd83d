"""Bus, inline and replay are the same run, byte for byte."""

import json
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

from tests.integration.processes import DATA

CASES = {"parts-3-easy": 25, "landmark-room": 60, "room-scan": 30, "landmark-mrclam": 150}
WORLDS = {"indoor-global": 10, "turtlebot-loops": 20}
SEEDS = (1, 2)

METRICS = {
    "completed",
    "finished",
    "swaps_unnoticed",
    "collisions",
    "npl",
    "nrl",
    "pi",
    "comp",
    "rpee_m",
    "ppee_m",
    "snr_db",
    "kurtosis",
    "crlb_ratio",
    "robot_nees",
    "final_error_mean_m",
    "final_error_max_m",
    "position_rmse_m",
    "position_median_m",
    "position_p95_m",
    "heading_rmse_rad",
    "nees_mean",
    "nees_low",
    "nees_high",
    "lost_fraction",
    "messages",
    "gaps",
    "complete",
    "content_digest",
}


def digest(path: Path) -> str:
    return content_digest(read_recording(path))


@pytest.mark.parametrize(("scenario", "nodes"), [("landmark-filters", 6), ("landmark-team", 10)])
def test_several_filters_and_several_robots_are_the_same_on_the_bus_inline_and_replayed(
    scenario, nodes, tmp_path, dynpf, here
):
    words = [scenario, "--set", "max_ticks=60"]
    if scenario == "landmark-team":
        log = tmp_path / "team.mcap"
        source = DATA / "mrclam" / "ds7_5robots_30s"
        if not source.is_dir():
            pytest.skip(f"the log {source} is not here")
        assert here("import", "mrclam", source, "--robot", "all", "-o", log).code == 0
        assert here("doctor", log).code == 0
        words += ["--log", log]
    on_bus, inline = tmp_path / "bus.mcap", tmp_path / "inline.mcap"
    run = dynpf("run", *words, "-o", on_bus)
    assert here("run", *words, "--runner", "inline", "-o", inline).code == 0
    assert run.wait() == 0, run.stderr
    assert digest(on_bus) == digest(inline)
    assert here("doctor", on_bus).code == 0
    replayed = json.loads(here("replay", on_bus, "--json").out)
    assert replayed["same"]
    assert len(replayed["counts"]) == nodes
    figures = json.loads(here("metrics", on_bus, "--json").out)["estimators"]
    assert len(figures) == (5 if scenario == "landmark-team" else 3)
    other = tmp_path / "other.mcap"  # the control
    assert here("run", *words, "--seed", 2, "--runner", "inline", "-o", other).code == 0
    assert digest(other) != digest(inline)


@pytest.mark.parametrize("scenario", CASES)
def test_bus_inline_and_replay_are_the_same_for_every_seed(scenario, tmp_path, dynpf, here, request):
    words = [scenario, "--set", f"max_ticks={CASES[scenario]}"]
    if scenario == "landmark-mrclam":
        words += ["--log", request.getfixturevalue("log")]
    digests = {}
    for seed in SEEDS:
        on_bus, inline = tmp_path / f"bus-{seed}.mcap", tmp_path / f"inline-{seed}.mcap"
        run = dynpf("run", *words, "--seed", seed, "-o", on_bus)
        assert here("run", *words, "--seed", seed, "--runner", "inline", "-o", inline).code == 0
        assert run.wait() == 0, run.stderr
        digests[seed] = digest(on_bus)
        assert digests[seed] == digest(inline)

        compared = here("diff", on_bus, inline, "--json")
        assert compared.code == 0
        assert json.loads(compared.out)["same"]
        replayed = here("replay", on_bus, "--json")
        assert replayed.code == 0, replayed.out
        nodes = json.loads(replayed.out)["counts"]
        assert all(node["steps"] == CASES[scenario] and node["digests"] for node in nodes.values())
        assert here("doctor", on_bus).code == 0

    again = tmp_path / "again.mcap"
    run = dynpf("run", *words, "--seed", 1, "-o", again)
    assert run.wait() == 0, run.stderr
    assert digest(again) == digests[1]

    assert len(set(digests.values())) == len(SEEDS), "another seed must give another run"
    differs = here("diff", tmp_path / "bus-1.mcap", tmp_path / "bus-2.mcap", "--json")
    assert differs.code == 1
    first = json.loads(differs.out)["first"]
    assert first["node"] in nodes
    assert first["a"] != first["b"]


@pytest.mark.parametrize("scenario", WORLDS)
def test_people_doors_gyro_and_lines_are_the_same_on_the_bus_inline_and_replayed(scenario, tmp_path, dynpf, here):
    words = [scenario, "--set", f"max_ticks={WORLDS[scenario]}"]
    on_bus, inline = tmp_path / "bus.mcap", tmp_path / "inline.mcap"
    run = dynpf("run", *words, "-o", on_bus)
    assert here("run", *words, "--runner", "inline", "-o", inline).code == 0
    assert run.wait() == 0, run.stderr
    assert digest(on_bus) == digest(inline)
    assert here("replay", on_bus, "--json").code == 0


def test_a_whole_run_on_the_bus_brings_every_part_home(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "parts-3-tracked", "--json", "-o", path)
    assert run.wait() == 0, run.stderr
    measures = json.loads(run.stdout)
    assert measures.keys() >= METRICS
    assert measures["completed"] is True
    assert measures["collisions"] == 0
    assert measures["complete"] is True
    assert measures["gaps"] == 0
    assert measures["recording"] == str(path)

    told = here("metrics", path, "--json")
    assert measures["page"] == str(path.with_suffix(".html"))
    assert json.loads(told.out) == {name: value for name, value in measures.items() if name != "page"}
    summary = here("metrics", path).out
    assert "all parts home, 0 collisions" in summary
    assert str(path) in summary
    assert measures["content_digest"] in summary
