"""Realtime runs over a bad link: what was lost and late is in the journal, and replays exactly."""

import json
from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry, encode_entry
from dynpf_services.scenario.load import SCENARIOS

TICKS = 80
FAULTS = """
[[faults]]
topic = "{topic}"
to = "estimator"
loss = 0.2
delay_s = 0.02
jitter_s = 0.15
"""


def scenario_with_faults(folder: Path, name: str, topics: tuple[str, ...]) -> Path:
    text = (SCENARIOS / f"{name}.toml").read_text().replace("max_ticks = 6000", f"max_ticks = {TICKS}")
    text = text.replace("tick_s", 'clock = "realtime"\ntick_s', 1)
    path = folder / "bad-link.toml"
    path.write_text(text + "".join(FAULTS.format(topic=topic) for topic in topics))
    return path


@pytest.mark.parametrize(
    ("name", "topics"),
    [
        ("parts-3-tracked", ("sensors/overhead", "sensors/gripper")),
        ("parts-3-easy", ("vision/detections", "sensors/gripper")),
    ],
)
def test_a_realtime_run_with_loss_and_delay_replays_exactly(name, topics, tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", scenario_with_faults(tmp_path, name, topics), "-o", path)
    assert run.wait() == 0, run.stderr
    assert here("doctor", path).code == 0

    recording = read_recording(path)
    (boot,) = recording.boots("estimator")
    steps = list(recording.journal("estimator", boot))
    consumed = [read for step in steps for read in step.consumed]
    for topic in topics:
        sent = sum(1 for _ in recording.messages(topic))
        kept = sum(read.topic == topic for read in consumed)
        assert sent > TICKS / 2
        assert 0.6 * sent < kept < 0.95 * sent, topic
    gaps = [json.loads(one.payload) for one in recording.messages("event/estimator")]
    assert {gap["topic"] for gap in gaps} == set(topics)
    order = [read.sequence for read in consumed if read.topic == topics[0]]
    assert order != sorted(order), "nothing came late"

    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.out
    counts = json.loads(replayed.out)["counts"]
    assert set(counts) == {node for node, _ in recording.journals()}
    assert counts["estimator"]["steps"] == len(steps) > 0

    swapped = tmp_path / "swapped.mcap"
    tick = write_swapped(recording, swapped, topics[0])
    noticed = here("replay", swapped, "--node", "estimator", "--json")
    assert noticed.code == 1
    first = json.loads(noticed.out)["first"]
    assert (first["node"], first["tick"]) == ("estimator", tick)
    assert first["a"] != first["b"]


def places_of(entry: JournalEntry, topic: str) -> list[tuple[int, int]]:
    """Return the step and the places of the messages of ``topic`` that a step makes an estimate of."""
    estimates = any(one.topic == "estimator/parts" for one in entry.produced)
    return [(entry.step, place) for place, one in enumerate(entry.consumed) if estimates and one.topic == topic]


def write_swapped(recording: Recording, path: Path, topic: str) -> int:
    """Write the recording with two of the estimator's inputs of ``topic`` swapped; return the first one's tick.

    Of several detections in one step, as there are when the machine is busy, the estimator takes the last, and an
    earlier one changes nothing. So these are of steps that have just one, and that make an estimate of it.
    """
    (boot,) = recording.boots("estimator")
    entries = {entry.step: entry for entry in recording.journal("estimator", boot)}
    alone = [places[0] for entry in entries.values() if len(places := places_of(entry, topic)) == 1]
    (early, here), *_, (late, there) = alone
    one, other = entries[early].consumed[here], entries[late].consumed[there]
    for step, place, read in ((early, here, other), (late, there, one)):
        consumed = list(entries[step].consumed)
        consumed[place] = read
        entries[step] = msgspec.structs.replace(entries[step], consumed=tuple(consumed))
    with RecordingWriter(path, recording.header, recording.attachments) as writer:
        for record in recording.records:
            payload = record.payload
            if record.topic == f"{JOURNAL_PREFIX}estimator":
                payload = encode_entry(entries[decode_entry(payload).step])
            envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
            writer.message(record.topic, envelope, payload)
        writer.close(complete=True, reason="altered")
    return entries[early].tick
