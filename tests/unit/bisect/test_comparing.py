"""What made two runs differ: the settings that did, and those that did not; a node; its inputs."""

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from dynpf_experiments.bisect.comparing import compare
from dynpf_experiments.bisect.settings import changes, mixed
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import decode_entry, encode_entry
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from msgspec import UNSET

TICKS = 12


def made(path: Path, *overrides: str) -> Recording:
    record_inline(load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}", *overrides], seed=1), path)
    return read_recording(path)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Recording:
    return made(tmp_path_factory.mktemp("plain") / "a.mcap")


def test_settings_that_belong_together_are_one_and_each_can_be_taken_alone():
    a = {"seed": 1, "map": {"kind": "x", "x": 1}, "faults": [{"loss": 0.1, "to": "e"}], "nodes": {"n": {"k": 1}}}
    b = {"seed": 2, "map": {"kind": "y", "y": 1}, "faults": [{"loss": 0.2, "to": "e"}], "nodes": {"n": {}, "m": {}}}
    found = changes(a, b)
    assert [change.key for change in found] == ["faults.0.loss", "map", "nodes.m", "nodes.n.k", "seed"]
    assert [change.b for change in found if change.key == "nodes.n.k"] == [UNSET]
    raw = json.loads(mixed(a, found))
    assert raw == {**b, "nodes": [{}, {}]}
    assert json.loads(mixed(a, found[:1]))["faults"] == b["faults"]
    assert json.loads(mixed(a, ())) == {**a, "nodes": [{"k": 1}]}


def test_settings_that_made_the_difference_are_told_from_those_that_did_not(plain, tmp_path, capsys):
    b = made(tmp_path / "b.mcap", "title=another", "estimator.n=150", "controller.speed=0.29", "rate=3.0")
    found = compare(plain, b).found
    assert found is not None
    assert [[change.key for change in cause.settings] for cause in found.causes] == [
        ["estimator.n"],
        ["controller.speed"],
    ]
    assert [cause.difference.node for cause in found.causes] == ["estimator", "controller"]
    assert [change.key for change in found.without_effect] == ["rate", "title"]
    assert (found.rest, found.a_again, found.b_again) == (None, None, None)
    assert main(["bisect", str(plain.path), str(b.path)]) == 0
    told = capsys.readouterr().out
    assert "cause: estimator.n, 500 in A, 150 in B\n" in told
    assert "with these settings alone A's run is B's, byte for byte" in told


def test_a_node_that_only_one_run_has_is_one_setting(plain, tmp_path):
    node = 'nodes.second={kind="waypoints", points=[[1.0, 1.0]], remap={"controller/command"="second/command"}}'
    found = compare(plain, made(tmp_path / "b.mcap", node)).found
    assert found is not None
    assert [[change.key for change in cause.settings] for cause in found.causes] == [["nodes.second"]]
    assert found.rest is None


def test_runs_that_are_the_same_have_no_cause(plain, tmp_path, capsys):
    same = made(tmp_path / "same.mcap", "title=another")
    assert compare(plain, same) == compare(same, plain)
    assert main(["bisect", str(plain.path), str(same.path)]) == 1
    assert "the runs are the same" in capsys.readouterr().out


def altered(recording: Recording, path: Path, change: Callable[[Recorded], bytes]) -> Recording:
    with RecordingWriter(path, recording.header, recording.attachments) as writer:
        for one in recording.records:
            envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
            writer.message(one.topic, envelope, change(one))
        writer.close(complete=True, reason="altered")
    return read_recording(path)


def test_a_node_that_made_something_else_of_the_same_inputs_is_named(plain, tmp_path, capsys):
    def change(one: Recorded) -> bytes:
        here = (one.topic, one.sequence) == ("estimator/state", 7)
        return one.payload.replace(b'"n_eff":', b'"n_eff":1') if here else one.payload

    b = altered(plain, tmp_path / "b.mcap", change)
    answer = compare(plain, b)
    assert answer.cause
    assert answer.found is None
    assert answer.origin is not None
    assert answer.origin.kind == "node"
    assert answer.notes[0].startswith("estimator of A is dynpf_systems.rooms.")
    assert answer.notes[0].endswith("makes it as recorded")
    assert "otherwise from tick 7 on" in answer.notes[1]
    assert main(["bisect", str(plain.path), str(b.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["origin"]["kind"] == "node"


def test_a_node_that_had_other_inputs_is_no_cause(plain, tmp_path):
    def change(one: Recorded) -> bytes:
        if (one.topic, one.sequence) != ("journal/estimator", 8):
            return one.payload
        entry = decode_entry(one.payload)
        return encode_entry(msgspec.structs.replace(entry, consumed=entry.consumed[::-1]))

    answer = compare(plain, altered(plain, tmp_path / "b.mcap", change))
    assert answer.origin is not None
    assert answer.origin.kind == "inputs"
    assert "step 8 of estimator, tick 8: input 0" in answer.origin.text
    assert not answer.cause


def test_a_run_that_ended_earlier_is_the_cause(plain, tmp_path):
    path = tmp_path / "b.mcap"
    calls = iter(range(TICKS))
    scenario = load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}"], seed=1)
    record_inline(scenario, path, stopped=lambda: "out of patience" if next(calls) >= 5 else "")
    answer = compare(plain, read_recording(path))
    assert answer.cause
    assert answer.origin is not None
    assert answer.origin.kind == "end"
    assert "out of patience (stopped)" in answer.origin.text
