"""Every reference recording reproduces what the table says, and whatever is altered in one is found and located."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from dynpf_formats.recording.diff import diff
from dynpf_formats.recording.digest import Key, content_digest
from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.references.check import check_part, parts
from dynpf_lab.references.runs import rerun_entry
from dynpf_lab.references.table import CHECKOUT, Entry, Made, read_table, recording_file, render_table
from dynpf_lab.references.update import MAX_BYTES, first_differences, report_file, update
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.journal import decode_entry, encode_entry
from dynpf_protocol.messages import Estimate, Message
from dynpf_runtime.replay import Replayed, replay_node, write_replayed
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import override_resolved
from dynpf_systems.parts.messages import PartsState

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
    held = []
    for one in recording.messages("truth/parts"):
        state = decode("truth/parts", one.payload, recording.topics)
        assert isinstance(state, PartsState)
        if state.held >= 0:
            held.append(state.parts[state.held])
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
    return rerun_entry(CHECKOUT, TABLE["landmarks"], tmp_path_factory.mktemp("made") / "landmarks.mcap")


def altered(
    recording: Recording, path: Path, change: Callable[[Recorded], bytes], header: RunHeader | None = None
) -> Recording:
    with RecordingWriter(path, header or recording.header, recording.attachments) as writer:
        for one in recording.records:
            envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
            writer.message(one.topic, envelope, change(one))
        writer.close(complete=True, reason="altered")
    return read_recording(path)


def replayed(recording: Recording, node: str) -> Replayed:
    scenario = override_resolved(recording.header.scenario, (), str(recording.path))
    return replay_node(recording, plan_of(scenario), node, keep=True)


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
    assert isinstance(before, Estimate)
    after = msgspec.structs.replace(before, x=before.x + 0.25)

    def change(one: Recorded) -> bytes:
        place = (one.node, one.topic, one.sequence) == (PLACE.node, PLACE.topic, PLACE.sequence)
        return encode(PLACE.topic, after) if place else one.payload

    bad = altered(made_here, tmp_path / "changed.mcap", change)
    first = diff(made_here, bad).first
    assert first is not None
    assert (first.node, first.tick, first.topic, first.sequence) == ("estimator", 40, PLACE.topic, 40)
    assert (first.field, first.a, first.b) == ("x", before.x, after.x)
    found = replayed(bad, "estimator").mismatch
    assert found == ("estimator", PLACE.topic, 40, 40, "x", after.x, before.x)
    # The node that consumed it is led elsewhere from the same tick on; nodes that did not are not.
    led_astray = replayed(bad, "controller").mismatch
    assert led_astray is not None
    assert led_astray.tick == 40
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
    assert first is not None
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
    assert first is not None
    assert (first.node, first.tick, first.topic, first.field) == (found.node, found.tick, found.topic, found.field)
    assert (first.a, first.b) == (found.recorded, found.replayed)


def test_another_seed_is_found_by_diff_and_by_replay(made_here, tmp_path):
    other = rerun_entry(CHECKOUT, msgspec.structs.replace(TABLE["landmarks"], seed=2), tmp_path / "other.mcap")
    first = diff(made_here, other).first
    assert first is not None
    assert first.tick is not None
    assert first.tick <= 1
    assert first.a != first.b
    scenario = override_resolved(made_here.header.scenario, ["seed=2"], "")
    for node in ("simulator", "sensors", "estimator"):
        found = replay_node(made_here, plan_of(scenario), node).mismatch
        assert found is not None
        assert found.node == node
        assert found.recorded != found.replayed


# --- another platform ----------------------------------------------------------------------------------------------


def test_a_difference_is_told_with_the_first_of_the_platform_and_a_platform_alone_is_none(checkout, tmp_path):
    update("first ones", checkout, status=clean)
    (row,) = read_table(checkout)
    path = recording_file(checkout, row)
    recording = read_recording(path)
    made = recording.header.provenance
    elsewhere = msgspec.structs.replace(made, platform={**made.platform, "blas": "OpenBLAS Z80"})
    header = msgspec.structs.replace(recording.header, provenance=elsewhere)
    altered(recording, tmp_path / "elsewhere.mcap", lambda one: one.payload, header)
    shutil.copyfile(tmp_path / "elsewhere.mcap", path)
    findings = [check_part(row, part, checkout) for part in parts(row)]
    assert {(one.verdict, one.note) for one in findings} == {("same", "")}

    def change(one: Recorded) -> bytes:
        return one.payload.replace(b'"n_eff":', b'"n_eff":1') if one.topic == "estimator/state" else one.payload

    altered(recording, tmp_path / "other.mcap", change, header)
    shutil.copyfile(tmp_path / "other.mcap", path)
    found = check_part(row, "estimator", checkout)
    assert found.verdict == "differs"
    assert found.note.startswith(f"recorded with BLAS OpenBLAS Z80, here {made.platform['blas']}; bytes should be")


# --- update --------------------------------------------------------------------------------------------------------

ROW = Entry(
    name="short", scenario="landmark-room", overrides=("max_ticks=12",), seed=3, nodes=("estimator",), why="control"
)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
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
    row = msgspec.structs.replace(ROW, why='say "so"', made=Made(digest="d" * 64, dynpf="0.1.0"))
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "table.toml").write_text(render_table([ROW, msgspec.structs.replace(row, name="b")]))
    assert read_table(tmp_path) == (ROW, msgspec.structs.replace(row, name="b"))
