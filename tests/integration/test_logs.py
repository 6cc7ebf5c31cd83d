"""Imported laser logs of each kind run the same on the bus, inline and in replay; what a run played plays again."""

import json
import math

import pytest
from dynpf_formats.recording.reader import read_recording

from tests.integration.processes import DATA

TICKS = 120
CARMEN = DATA / "carmen" / "intel_30-150s.log"
BAGS = DATA / "bags" / "drl"


EXPORTED = ("estimator/state", "log/truth")


def poses(tum):
    """Positions by their stamps' texts."""
    return {line.split()[0]: tuple(map(float, line.split()[1:3])) for line in tum.splitlines()}


@pytest.fixture(name="laser_log", params=["carmen", "rosbag"])
def imported(request, tmp_path, here):
    if not CARMEN.is_file() or not BAGS.is_dir():
        pytest.skip(f"the logs are not in {DATA}")
    path = tmp_path / "log.mcap"
    if request.param == "carmen":
        words = [CARMEN, "--map-from-poses", 0.05]
    else:
        pytest.importorskip("rosbags", reason="the package rosbags is not installed")
        words = [BAGS / "jarvis_circular_path_fast.bag", "--map", BAGS / "i-108_10mm.yaml"]
        words += ["--truth-offset", -14.48, -3.79, 0.0313, "--truth-shift", 0.08]
    told = here("import", request.param, *words, "-o", path)
    assert told.code == 0, told.err
    return path


def test_bus_inline_and_replay_are_the_same(laser_log, tmp_path, dynpf, here):
    words = ["laser-log", "--log", laser_log, "--set", f"max_ticks={TICKS}", "--set", "estimator.n=300"]
    on_bus, inline, again = (tmp_path / f"{name}.mcap" for name in ("bus", "inline", "again"))
    run = dynpf("run", *words, "-o", on_bus)
    assert here("run", *words, "--runner", "inline", "-o", inline).code == 0
    assert run.wait() == 0, run.stderr
    compared = json.loads(here("diff", on_bus, inline, "--json").out)
    assert compared["same"]
    assert compared["counts"]["estimator/state"]["a"] == TICKS
    replayed = here("replay", on_bus, "--json")
    assert replayed.code == 0, replayed.out
    assert json.loads(replayed.out)["counts"]["estimator"]["steps"] == TICKS
    measures = json.loads(here("metrics", inline, "--json").out)
    assert measures["position_rmse_m"] < 0.2

    if "clock_backwards" in read_recording(laser_log).header.scenario:  # CARMEN: a reference pose for each scan
        paths = {topic: poses(here("export", inline, "--format", "tum", "--topic", topic).out) for topic in EXPORTED}
        estimates, truth = (paths[topic] for topic in EXPORTED)
        errors = [math.dist(estimates[stamp], truth[stamp]) for stamp in truth if stamp in estimates]
        assert len(errors) >= 5
        rmse = math.sqrt(sum(error**2 for error in errors) / len(errors))
        assert rmse == pytest.approx(measures["position_rmse_m"], abs=1e-9)

    words[2] = inline  # which holds what it played, and its map
    assert here("run", *words, "--runner", "inline", "-o", again).code == 0
    records = [name for name in compared["counts"] if name.startswith("log/")]
    counts = json.loads(here("diff", inline, again, "--json").out)["counts"]
    assert records
    assert all(counts[name]["a"] == counts[name]["b"] and not counts[name]["differ"] for name in records)


def test_a_log_played_at_a_tenth_at_once_and_as_fast_as_it_goes_gives_the_same_estimates(log, tmp_path, dynpf, here):
    runs = {}
    for rate in (0.1, 1.0, None):
        path = tmp_path / f"{rate}.mcap"
        words = ["landmark-mrclam", "--log", log, "--set", "max_ticks=6", "--set", "estimator.n=100", "-o", path]
        runs[path] = dynpf("run", *words, *([] if rate is None else ["--set", f"rate={rate}"])), rate
    for path, (run, rate) in runs.items():
        assert run.wait() == 0, run.stderr
        recording = read_recording(path)
        records = list(recording.messages("estimator/state"))
        assert len(records) == 6
        if rate is not None:  # that much the clock on the wall must have gone on, at the least
            passed_ns = records[-1].publish_ns - records[0].publish_ns
            assert passed_ns > 0.9 * (records[-1].stamp_ns - records[0].stamp_ns) / rate - 0.05e9
    first, *others = runs
    for other in others:
        assert json.loads(here("diff", first, other, "--json").out)["same"]
