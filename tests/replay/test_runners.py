"""Inline and replay are the same run, and a node that was taken out in mid-run goes on as if nothing had been."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.messages import Message
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_runtime import executor
from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Received, Step, decode_state, encode_state, state_digest
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import build_nodes, plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario

TICKS = {
    "landmark-room": 60,
    "room-scan": 40,
    "room-lines": 40,
    "parts-3-tracked": 120,
    "parts-3-easy": 6,
    "colon-case-5": 11,
    "colon-own-maps": 11,
    "parts-3-disturbed": 110,
    "parts-3-lens": 6,
    "indoor-tracking": 20,
    "indoor-global": 10,
    "turtlebot-room": 16,
    "turtlebot-loops": 20,
}
CASES = [(name, node) for name in TICKS for node in load_scenario(name).nodes]


def scenario(name: str, seed: int = 1) -> Scenario:
    return load_scenario(name, overrides=[f"max_ticks={TICKS[name]}"], seed=seed)


def run(name: str, path: Path, seed: int = 1) -> Recording:
    resolved = scenario(name, seed)
    assert record_inline(resolved, path) == TICKS[name]
    return read_recording(path)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> dict[str, Recording]:
    folder = tmp_path_factory.mktemp("runs")
    return {name: run(name, folder / f"{name}.mcap") for name in TICKS}


@pytest.mark.parametrize("name", TICKS)
def test_same_seed_gives_the_same_run_and_another_seed_another(recordings, name, tmp_path):
    digest = content_digest(recordings[name])
    assert content_digest(run(name, tmp_path / "again.mcap")) == digest
    assert content_digest(run(name, tmp_path / "other.mcap", seed=2)) != digest


@pytest.mark.parametrize("name", TICKS)
def test_a_run_without_a_sink_has_the_messages_of_the_recording_and_encodes_none(recordings, name, monkeypatch):
    observed: list[Received] = []
    with monkeypatch.context() as patched:
        if not scenario(name).faults:  # a gap is told by its host, as on the bus
            patched.setattr(executor, "encode", lambda *_: pytest.fail("a message was encoded"))
        assert run_inline(plan_of(scenario(name)), [], observe=observed.append).ticks == TICKS[name]
    sent = [
        (one.node, one.topic, one.sequence, one.stamp_ns, encode(one.topic, one.message, known_topics()))
        for one in observed
    ]
    recorded = [
        (one.node, one.topic, one.sequence, one.stamp_ns, one.payload)
        for one in recordings[name].messages()
        if not one.topic.startswith(SNAPSHOT_PREFIX)
    ]
    assert sorted(sent) == sorted(recorded)
    assert observed


@pytest.mark.parametrize(("name", "node"), CASES)
def test_replay_of_a_node_is_what_it_did_inline(recordings, name, node):
    outcome = replay_node(recordings[name], plan_of(scenario(name)), node)
    assert outcome.mismatch is None
    assert outcome.steps == TICKS[name]
    assert outcome.messages > 0
    assert outcome.digests > 0


def steps(recording: Recording, node: str) -> Iterator[Step]:
    (boot,) = recording.boots(node)
    for entry in recording.journal(node, boot):
        inputs = []
        for one in entry.consumed:
            record = recording.find(one.node, one.boot, one.topic, one.sequence)
            assert record is not None
            message: Message = decode(one.topic, record.payload, known_topics())
            inputs.append(Received(one.topic, one.node, one.boot, one.sequence, record.stamp_ns, message))
        yield Step(entry.step, entry.tick, entry.stamp_ns, tuple(inputs))


@pytest.mark.parametrize(("name", "node"), CASES)
def test_node_thawed_in_mid_run_goes_on_as_the_frozen_one(recordings, name, node):
    told = list(steps(recordings[name], node))
    middle = len(told) // 2
    frozen, thawed, fresh = (build_nodes(scenario(name))[node] for _ in range(3))
    for step in told[:middle]:
        frozen.step(step)
    state = encode_state(frozen.freeze())
    thawed.thaw(decode_state(state))
    results = [frozen.step(step) for step in told[middle:]]
    assert [thawed.step(step) for step in told[middle:]] == results
    assert state_digest(thawed.freeze()) == state_digest(frozen.freeze())
    # The control: without its state the node does something else, if it has one at all.
    if frozen.freeze():
        assert encode_state(fresh.freeze()) != state
