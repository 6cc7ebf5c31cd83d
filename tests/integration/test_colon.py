"""COLON on the bus: the same run as inline and in replay, and the posterior over maps follows what happens."""

import json

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording


@pytest.mark.parametrize(("case", "true"), [(2, "b"), (5, "none of these")])
def test_the_posterior_follows_the_map_and_all_ways_to_run_are_the_same(case, true, tmp_path, dynpf, here):
    scenario, path, inline = f"colon-case-{case}", tmp_path / "bus.mcap", tmp_path / "inline.mcap"
    run = dynpf("run", scenario, "--json", "-o", path)
    assert here("run", scenario, "--runner", "inline", "-o", inline).code == 0
    assert here("run", scenario, "--runner", "inline", "--seed", 2, "-o", tmp_path / "other.mcap").code == 0
    assert run.wait() == 0, run.stderr
    digests = [content_digest(read_recording(one)) for one in (path, inline, tmp_path / "other.mcap")]
    assert digests[0] == digests[1] != digests[2]
    assert here("replay", path).code == 0
    assert here("doctor", path).code == 0

    measures = json.loads(run.stdout)
    assert measures["posterior_truth"] > 0.95
    assert measures["delay_steps"] <= 1.0
    assert measures["error_position_px"] < 3.0
    found = [json.loads(one.payload) for one in read_recording(path).messages("estimator/capsule")]
    truth = [json.loads(one.payload)["map"] for one in read_recording(path).messages("truth/capsule")]
    assert truth == ["a"] * 8 + ["b" if case == 2 else "c"] * 8
    assert [one["map"] for one in found[:8]] == ["a"] * 8
    assert {one["map"] for one in found[10:]} == {true}

    # The control: a filter that holds on to its map, and a tube that stays as it is.
    for override, expected in (("estimator.filter.change=0.0", "missed"), ("colon.true=[{map='a'}]", "false_alarm")):
        control = tmp_path / f"{expected}.mcap"
        words = ["--set", override, "--set", "estimator.filter.schedule=ignored", "--runner", "inline", "-o", control]
        assert here("run", scenario, *words).code == 0
        measures = json.loads(here("metrics", control, "--json").out)
        assert measures[expected] is (expected == "missed")
        assert (measures["posterior_truth"] > 0.9) is (expected == "false_alarm")
