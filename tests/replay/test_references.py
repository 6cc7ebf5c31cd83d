"""Every reference recording reproduces what the table says, and whatever is altered in one is found and located."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from protocol.codec import decode, encode
from protocol.envelope import Envelope
from protocol.journal import decode_entry, encode_entry
from protocol.messages import Estimate, Message, PartEstimate
from protocol.topics import TOPICS
from services.errors import UsageError
from services.nodes import build_node
from services.recording.diff import diff
from services.recording.digest import Key, content_digest
from services.recording.reader import Recorded, Recording, read_recording
from services.recording.writer import RecordingWriter
from services.references.check import check_part, parts
from services.references.runs import run_anew
from services.references.table import CHECKOUT, Entry, Made, read_table, recording_file, render_table
from services.references.tolerance import Said, Tolerances, first_beyond, read_tolerances
from services.references.update import MAX_BYTES, first_differences, report_file, update
from services.runners.replay import Replayed, replay_node, write_replayed
from services.scenario import override_resolved

TABLE = {entry.name: entry for entry in read_table()}
HELD = [entry for entry in TABLE.values() if not entry.log]
PLACE = Key("estimator", "estimator/state", 0, 40)


@pytest.mark.parametrize(("name", "part"), [(name, part) for name, entry in TABLE.items() for part in parts(entry)])
def test_reference_is_reproduced(name, part):
    finding = check_part(TABLE[name], part)
    if finding.verdict == "skipped":
        pytest.skip(finding.note)
    assert finding.verdict == "same", finding


@pytest.mark.parametrize("entry", HELD, ids=lambda entry: entry.name)
def test_reference_is_small_and_covers_every_node_of_its_run(entry):
    path = recording_file(CHECKOUT, entry)
    recording = read_recording(path)
    assert path.stat().st_size <= MAX_BYTES
    assert sum(1 for _ in recording.messages("camera/image")) <= 6
    assert {node for node, _ in recording.journals()} == set(entry.nodes)


def test_there_is_no_recording_that_the_table_does_not_tell_of():
    assert {path.stem for path in (CHECKOUT / "recordings").glob("*.mcap")} == {entry.name for entry in HELD}


def test_rearrangement_grips_a_part_and_moves_it():
    recording = read_recording(recording_file(CHECKOUT, TABLE["rearrangement"]))
    states = [decode("truth/parts", one.payload) for one in recording.messages("truth/parts")]
    held = [state.parts[state.held] for state in states if state.held >= 0]
    assert np.hypot(held[0].x - held[-1].x, held[0].y - held[-1].y) > 0.1


def test_faults_lose_messages_and_delay_them():
    recording = read_recording(recording_file(CHECKOUT, TABLE["faults"]))
    (boot,) = recording.boots("estimator")
    entries = list(recording.journal("estimator", boot))
    consumed = [one for entry in entries for one in entry.consumed if one.topic == "sensors/odometry"]
    sequences = [one.sequence for one in consumed]
    assert 0 < len(sequences) < sum(1 for _ in recording.messages("sensors/odometry")), "none was lost"
    assert sequences != sorted(sequences), "none was late"


# --- controls: what is altered is found ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made_here(tmp_path_factory) -> Recording:
    """The run of the table's row "landmarks", made on this platform, where bytes can be compared."""
    return run_anew(CHECKOUT, TABLE["landmarks"], tmp_path_factory.mktemp("made") / "landmarks.mcap")


def altered(recording: Recording, path: Path, change: Callable[[Recorded], bytes]) -> Recording:
    with RecordingWriter(path, recording.header, recording.attachments) as writer:
        for one in recording.records:
            envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
            writer.message(one.topic, envelope, change(one))
        writer.close(complete=True, reason="altered")
    return read_recording(path)


def replayed(recording: Recording, node: str) -> Replayed:
    scenario = override_resolved(recording.header.scenario, (), str(recording.path))
    return replay_node(recording, build_node(scenario, node), scenario.state_digest_ticks, keep=True)


def message(recording: Recording, key: Key) -> Message:
    record = recording.find(key.node, recording.boots(key.node)[key.start], key.topic, key.sequence)
    assert record is not None
    return decode(key.topic, record.payload)


def test_unaltered_copy_is_the_same(made_here, tmp_path):
    copy = altered(made_here, tmp_path / "copy.mcap", lambda one: one.payload)
    assert diff(made_here, copy).same
    assert content_digest(copy) == content_digest(made_here)
    outcome = replayed(copy, "estimator")
    assert outcome.mismatch is None
    assert outcome.steps == 150
    assert outcome.messages >= 2 * 150
    assert outcome.digests == 15


def test_one_changed_value_is_found_by_diff_and_by_replay(made_here, tmp_path):
    before = message(made_here, PLACE)
    after = msgspec.structs.replace(before, x=before.x + 0.25)

    def change(one: Recorded) -> bytes:
        place = (one.node, one.topic, one.sequence) == (PLACE.node, PLACE.topic, PLACE.sequence)
        return encode(PLACE.topic, after) if place else one.payload

    bad = altered(made_here, tmp_path / "changed.mcap", change)
    first = diff(made_here, bad).first
    assert (first.node, first.tick, first.topic, first.sequence) == ("estimator", 40, PLACE.topic, 40)
    assert (first.field, first.a, first.b) == ("x", before.x, after.x)
    found = replayed(bad, "estimator").mismatch
    assert found == ("estimator", PLACE.topic, 40, 40, "x", after.x, before.x)
    # The node that consumed it is led elsewhere from the same tick on; nodes that did not are not.
    assert replayed(bad, "controller").mismatch.tick == 40
    assert replayed(bad, "sensors").mismatch is None
    assert [(one.topic, one.field) for one in first_differences(made_here, bad)] == [(PLACE.topic, "x")]


def test_reordered_input_is_found_by_diff_by_replay_and_in_what_replay_wrote(made_here, tmp_path):
    """Odometry of steps 40 and 41 of the estimator, exchanged in its journal."""
    entries = {entry.step: entry for entry in made_here.journal("estimator", made_here.boots("estimator")[0])}
    odometry = {
        step: next(one for one in entries[step].consumed if one.topic == "sensors/odometry") for step in (40, 41)
    }

    def change(one: Recorded) -> bytes:
        if one.topic != "journal/estimator" or one.sequence not in odometry:
            return one.payload
        entry = decode_entry(one.payload)
        other = odometry[81 - entry.step]
        exchanged = tuple(other if each == odometry[entry.step] else each for each in entry.consumed)
        return encode_entry(msgspec.structs.replace(entry, consumed=exchanged))

    bad = altered(made_here, tmp_path / "reordered.mcap", change)
    first = diff(made_here, bad).first
    assert (first.node, first.tick, first.topic, first.sequence) == ("estimator", 40, "journal/estimator", 40)
    assert first.field.startswith("consumed[")
    assert (first.a, first.b) == ("sensors/odometry 40 of sensors", "sensors/odometry 41 of sensors")
    outcome = replayed(bad, "estimator")
    found = outcome.mismatch
    assert found is not None
    assert found.tick in (40, 41)
    assert found.topic.startswith("estimator/")
    assert found.recorded != found.replayed
    with RecordingWriter(tmp_path / "led-astray.mcap", bad.header) as writer:
        write_replayed(bad, [outcome], writer)
        writer.close(complete=True, reason="replayed")
    first = diff(made_here, read_recording(tmp_path / "led-astray.mcap")).first
    assert (first.node, first.tick, first.topic, first.field) == (found.node, found.tick, found.topic, found.field)
    assert (first.a, first.b) == (found.recorded, found.replayed)


def test_another_seed_is_found_by_diff_and_by_replay(made_here, tmp_path):
    other = run_anew(CHECKOUT, msgspec.structs.replace(TABLE["landmarks"], seed=2), tmp_path / "other.mcap")
    first = diff(made_here, other).first
    assert first.tick is not None
    assert first.tick <= 1
    assert first.a != first.b
    scenario = override_resolved(made_here.header.scenario, ["seed=2"], "")
    for node in ("simulator", "sensors", "estimator"):
        found = replay_node(made_here, build_node(scenario, node), scenario.state_digest_ticks).mismatch
        assert found is not None
        assert found.node == node
        assert found.recorded != found.replayed


# --- another platform ----------------------------------------------------------------------------------------------

LIMITS = Tolerances(first_ticks=3, topics={"estimator/state": {"*": 1e-9, "covariance": 1e-12}})
ESTIMATE = Estimate(x=1.0, y=2.0, theta=0.5, covariance=(0.1,) * 9, n_eff=50.0)


def said(count: int = 6, at: int = -1, **changes: object) -> dict[Key, Said]:
    """An estimate a tick, that of tick ``at`` with ``changes``."""
    told = {}
    for tick in range(count):
        estimate = msgspec.structs.replace(ESTIMATE, **changes) if tick == at else ESTIMATE
        payload = encode("estimator/state", estimate)
        told[Key("estimator", "estimator/state", 0, tick)] = Said(tick, tick, payload)
    return told


def test_values_within_tolerance_pass_and_beyond_it_are_located():
    assert first_beyond(said(), said(at=1, x=1.0 + 5e-10), LIMITS) is None
    found = first_beyond(said(), said(at=1, x=1.0 + 2e-9), LIMITS)
    assert found == ("estimator", "estimator/state", 1, 1, "x", 1.0, 1.0 + 2e-9)
    off = (*ESTIMATE.covariance[:4], 0.1 + 1e-10, *ESTIMATE.covariance[5:])
    assert first_beyond(said(), said(at=1, covariance=off), LIMITS).field == "covariance[4]"


def test_field_without_tolerance_has_to_be_equal():
    bare = Tolerances(first_ticks=3, topics={})
    assert first_beyond(said(), said(), bare) is None
    assert first_beyond(said(), said(at=1, x=float(np.nextafter(1.0, 2.0))), bare).field == "x"


def test_whole_numbers_and_lengths_have_to_be_equal():
    loose = Tolerances(first_ticks=3, topics={"estimator/state": {"*": 9.0}})
    assert first_beyond(said(), said(at=1, held=0), loose).field == "held"
    part = PartEstimate(x=0.0, y=0.0, variance=0.0, seen=True)
    assert first_beyond(said(), said(at=1, parts=(part,)), loose).field == "parts.length"


def test_late_values_are_compared_of_stateless_nodes_only():
    late = said(at=3, x=7.0)
    assert first_beyond(said(), late, LIMITS) is None
    assert first_beyond(said(), late, LIMITS, stateless={"estimator"}).tick == 3


def test_counts_are_compared_to_the_end():
    found = first_beyond(said(6), said(5), LIMITS)
    assert (found.field, found.recorded, found.replayed) == ("count", 6, 5)


def test_frames_are_compared_by_their_pixels():
    recording = read_recording(recording_file(CHECKOUT, TABLE["camera"]))
    frames = [one.payload for one in recording.messages("camera/image")][:2]
    key, limits = Key("simulator", "camera/image", 0, 0), Tolerances(1, {"camera/image": {"data": 8.0}})
    stamped = [msgspec.json.encode({**msgspec.json.decode(frame), "timestamp": 0}) for frame in frames]
    old, same, other = ({key: Said(0, 0, frame)} for frame in (stamped[0], stamped[0], stamped[1]))
    assert first_beyond(old, same, limits) is None
    assert first_beyond(old, other, limits).field.startswith("data, pixel")


def test_every_topic_of_the_references_has_a_small_tolerance():
    tolerances = read_tolerances(CHECKOUT)
    topics = {
        source.topic
        for entry in HELD
        for source in read_recording(recording_file(CHECKOUT, entry)).sources
        if source.topic in TOPICS and TOPICS[source.topic].compared
    }
    assert topics == set(tolerances.topics)
    limits = [limit for fields in tolerances.topics.values() for name, limit in fields.items() if name != "data"]
    assert max(limits) <= 1e-6
    assert tolerances.first_ticks >= 20


def test_references_hold_with_other_processor_features():
    """Another platform for real: NumPy and OpenCV without the vector instructions that they choose at run time."""
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    if not found:
        pytest.skip("NumPy uses no instructions here that can be switched off")
    lacking = {"NPY_DISABLE_CPU_FEATURES": ",".join(found), "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,AVX,FP16,SSE4.2"}
    command = [sys.executable, "-P", "-m", "services.cli.main", "references", "check", "--json"]
    environment = {**os.environ, **lacking, "PYTHONPATH": str(CHECKOUT)}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    notes = [one["note"] for one in msgspec.json.decode(ended.stdout)["findings"] if one["part"] == "estimator"]
    assert len(notes) == len(HELD)
    assert all("another platform" in note for note in notes)


# --- update --------------------------------------------------------------------------------------------------------

ROW = Entry(
    name="short", scenario="landmark-room", overrides=("max_ticks=12",), seed=3, nodes=("estimator",), why="control"
)


@pytest.fixture
def checkout(tmp_path) -> Path:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "table.toml").write_text(render_table([ROW]), encoding="utf-8")
    return tmp_path


def clean(_: Path) -> str:
    return ""


def test_update_wants_a_reason(checkout):
    with pytest.raises(UsageError, match="--reason"):
        update("  ", checkout, status=clean)
    assert not report_file(checkout).exists()


def test_update_refuses_uncommitted_changes_but_those_in_recordings(checkout):
    subprocess.run(["git", "init", "--quiet", str(checkout)], check=True)
    (checkout / "stray.py").write_text("", encoding="utf-8")
    with pytest.raises(UsageError, match=r"uncommitted changes: stray\.py"):
        update("a reason", checkout)
    (checkout / "stray.py").unlink()
    assert [change.new.name for change in update("a reason", checkout)] == ["short"]


def test_update_refuses_where_data_is_absent(checkout):
    played = msgspec.structs.replace(ROW, name="played", scenario="landmark-mrclam", overrides=(), log="nowhere")
    (checkout / "recordings" / "table.toml").write_text(render_table([ROW, played]), encoding="utf-8")
    with pytest.raises(UsageError, match="nowhere"):
        update("a reason", checkout, status=clean)
    assert not recording_file(checkout, ROW).exists()


def test_update_writes_what_changed_and_nothing_where_nothing_did(checkout):
    (first,) = update("first ones", checkout, status=clean)
    (row,) = read_table(checkout)
    assert row == first.new
    assert check_part(row, "file", checkout).verdict == "same"
    assert check_part(row, "run", checkout).verdict == "same"
    before = {path.name: path.read_bytes() for path in (checkout / "recordings").iterdir()}
    assert update("again", checkout, status=clean) == []
    assert {path.name: path.read_bytes() for path in (checkout / "recordings").iterdir()} == before

    # Another scenario under the same name is another run: found, told of, and made anew.
    other = msgspec.structs.replace(row, seed=4)
    (checkout / "recordings" / "table.toml").write_text(render_table([other]), encoding="utf-8")
    found = check_part(other, "run", checkout)
    assert found.verdict == "differs"
    assert found.first is not None
    (change,) = update("another seed", checkout, status=clean)
    told = {(one.node, one.topic): one for one in change.first}
    odometry = told["sensors", "sensors/odometry"]
    assert odometry.a != odometry.b
    assert ("estimator", "journal/estimator") in told
    report = report_file(checkout).read_text(encoding="utf-8")
    assert "Reason: another seed" in report
    assert (
        f"| sensors | sensors/odometry | {odometry.tick} | 0 | {odometry.field} | {odometry.a} | {odometry.b} |"
        in report
    )
    assert "| position_rmse_m | " in report
    assert check_part(read_table(checkout)[0], "run", checkout).verdict == "same"


def test_altered_file_is_found_and_made_anew(checkout):
    update("first ones", checkout, status=clean)
    (row,) = read_table(checkout)
    path = recording_file(checkout, row)
    data = path.read_bytes()
    path.write_bytes(data[:2000] + bytes([data[2000] ^ 1]) + data[2001:])
    assert check_part(row, "file", checkout).verdict == "differs"
    (change,) = update("mended", checkout, status=clean)
    assert "cannot be read" in change.note
    assert check_part(row, "file", checkout).verdict == "same"


def test_outside_a_checkout_the_command_says_so(tmp_path):
    with pytest.raises(UsageError, match="from a checkout"):
        read_table(tmp_path)


def test_table_survives_being_written(tmp_path):
    row = msgspec.structs.replace(ROW, why='say "so"', made=Made(digest="d" * 64, dynpf="0.1.0", platform="p"))
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "table.toml").write_text(render_table([ROW, msgspec.structs.replace(row, name="b")]))
    assert read_table(tmp_path) == (ROW, msgspec.structs.replace(row, name="b"))
