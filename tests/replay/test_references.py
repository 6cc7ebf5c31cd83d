"""Every reference recording reproduces what the table says, and whatever is altered in one is found and located."""

import shutil
import subprocess
import sys
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
from dynpf_lab.references.runs import find_code, rerun_entry
from dynpf_lab.references.table import CHECKOUT, Table, read_table
from dynpf_lab.references.update import MAX_BYTES, first_differences, update
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import ScenarioError, UsageError
from dynpf_protocol.journal import decode_entry, encode_entry
from dynpf_protocol.messages import Estimate, Message
from dynpf_runtime.replay import Replayed, replay_node, write_replayed
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import override_resolved
from dynpf_systems.parts.messages import PartsState

OWN = read_table()
TABLE = {entry.name: entry for entry in OWN.rows}
HELD = [entry for entry in TABLE.values() if entry.kept]
PLACE = Key("estimator", "estimator/state", 0, 40)


@pytest.mark.parametrize(
    ("name", "part"), [(name, part) for name, entry in TABLE.items() for part in parts(OWN, entry)]
)
def test_reference_is_reproduced(name, part):
    finding = check_part(OWN, TABLE[name], part)
    if finding.verdict == "skipped":
        pytest.skip(finding.note)
    assert finding.verdict == "same", finding


@pytest.mark.parametrize("entry", HELD, ids=lambda entry: entry.name)
def test_reference_is_small_and_covers_every_node_of_its_run(entry):
    path = OWN.recording(entry)
    recording = read_recording(path)
    assert path.stat().st_size <= MAX_BYTES
    assert sum(1 for _ in recording.messages("camera/image")) <= 6
    assert {node for node, _ in recording.journals()} == set(entry.nodes)


def test_there_is_no_recording_that_the_table_does_not_tell_of():
    assert {path.stem for path in (CHECKOUT / "recordings").glob("*.mcap")} == {entry.name for entry in HELD}


def test_rearrangement_grips_a_part_and_moves_it():
    recording = read_recording(OWN.recording(TABLE["rearrangement"]))
    held = []
    for one in recording.messages("truth/parts"):
        state = decode("truth/parts", one.payload, recording.topics)
        assert isinstance(state, PartsState)
        if state.held >= 0:
            held.append(state.parts[state.held])
    assert np.hypot(held[0].x - held[-1].x, held[0].y - held[-1].y) > 0.1


def test_faults_lose_messages_and_delay_them():
    recording = read_recording(OWN.recording(TABLE["faults"]))
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
    return rerun_entry(OWN, TABLE["landmarks"], tmp_path_factory.mktemp("made") / "landmarks.mcap")


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
    other = rerun_entry(OWN, msgspec.structs.replace(TABLE["landmarks"], seed=2), tmp_path / "other.mcap")
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


def test_a_difference_is_told_with_the_first_of_the_platform_and_a_platform_alone_is_none(place, tmp_path):
    update(read_table(place), "first ones", status=clean)
    table = read_table(place)
    (row,) = table.rows
    path = table.recording(row)
    recording = read_recording(path)
    made = recording.header.provenance
    elsewhere = msgspec.structs.replace(made, platform={**made.platform, "blas": "OpenBLAS Z80"})
    header = msgspec.structs.replace(recording.header, provenance=elsewhere)
    altered(recording, tmp_path / "elsewhere.mcap", lambda one: one.payload, header)
    shutil.copyfile(tmp_path / "elsewhere.mcap", path)
    findings = [check_part(table, row, part) for part in parts(table, row)]
    assert {(one.verdict, one.note) for one in findings} == {("same", "")}

    def change(one: Recorded) -> bytes:
        return one.payload.replace(b'"n_eff":', b'"n_eff":1') if one.topic == "estimator/state" else one.payload

    altered(recording, tmp_path / "other.mcap", change, header)
    shutil.copyfile(tmp_path / "other.mcap", path)
    found = check_part(table, row, "estimator")
    assert found.verdict == "differs"
    assert found.note.startswith(f"recorded with BLAS OpenBLAS Z80, here {made.platform['blas']}; bytes should be")


# --- update --------------------------------------------------------------------------------------------------------

ROWS = """# Of our own.
[[recording]] # short
name = "short"
scenario = "landmark-room"
overrides = ["max_ticks=12"]
seed = 3
nodes = ["estimator"]

# What follows has no recording.
"""
ALONE = """[[recording]]
name = "alone"
scenario = "landmark-room"
overrides = ["max_ticks=5"]
seed = 3
keep = false
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "table.toml").write_text(ROWS, encoding="utf-8")
    return tmp_path / "table.toml"


def clean(_: Table) -> str:
    return ""


def verdict(place: Path, part: str) -> str:
    table = read_table(place)
    return check_part(table, table.rows[0], part).verdict


def test_update_wants_a_reason(place):
    with pytest.raises(UsageError, match="--reason"):
        update(read_table(place), "  ", status=clean)
    assert not read_table(place).report.exists()


def test_update_refuses_uncommitted_changes_but_those_that_it_makes(place):
    subprocess.run(["git", "init", "--quiet", str(place.parent)], check=True)
    stray = place.with_name("stray.py")
    stray.write_text("", encoding="utf-8")
    with pytest.raises(UsageError, match=r"uncommitted changes: stray\.py"):
        update(read_table(place), "a reason")
    stray.unlink()
    assert [change.new.name for change in update(read_table(place), "a reason")] == ["short"]
    assert update(read_table(place), "again") == []


def test_update_refuses_where_data_is_absent(place):
    place.write_text(f'{ROWS}{ALONE}log = "nowhere"\n', encoding="utf-8")
    table = read_table(place)
    with pytest.raises(UsageError, match="nowhere"):
        update(table, "a reason", status=clean)
    assert not table.recording(table.rows[0]).exists()


def test_update_writes_what_changed_and_nothing_where_nothing_did(place):
    (first,) = update(read_table(place), "first ones", status=clean)
    table = read_table(place)
    assert table.rows == (first.new,)
    assert (verdict(place, "file"), verdict(place, "run")) == ("same", "same")
    before = {path.name: path.read_bytes() for path in place.parent.iterdir()}
    assert update(table, "again", status=clean) == []
    assert {path.name: path.read_bytes() for path in place.parent.iterdir()} == before

    # Another scenario under the same name is another run: found, told of, and made anew.
    place.write_text(place.read_text().replace("seed = 3", "seed = 4"), encoding="utf-8")
    table = read_table(place)
    found = check_part(table, table.rows[0], "run")
    assert found.verdict == "differs"
    assert found.first is not None
    (change,) = update(table, "another seed", status=clean)
    told = {(one.node, one.topic): one for one in change.first}
    odometry = told["sensors", "sensors/odometry"]
    assert odometry.a != odometry.b
    assert ("estimator", "journal/estimator") in told
    report = table.report.read_text(encoding="utf-8")
    assert "Reason: another seed" in report
    assert (
        f"| sensors | sensors/odometry | {odometry.tick} | 0 | {odometry.field} | {odometry.a} | {odometry.b} |"
        in report
    )
    assert "| position_rmse_m | " in report
    assert verdict(place, "run") == "same"


def test_altered_file_is_found_and_made_anew(place):
    update(read_table(place), "first ones", status=clean)
    table = read_table(place)
    path = table.recording(table.rows[0])
    data = path.read_bytes()
    path.write_bytes(data[:2000] + bytes([data[2000] ^ 1]) + data[2001:])
    assert verdict(place, "file") == "differs"
    (change,) = update(table, "mended", status=clean)
    assert "cannot be read" in change.note
    assert verdict(place, "file") == "same"


def test_outside_a_checkout_the_command_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("dynpf_lab.references.table.REPOSITORY", tmp_path / "table.toml")
    with pytest.raises(UsageError, match="from a checkout"):
        read_table(tmp_path / "table.toml")


# --- a table of one's own ------------------------------------------------------------------------------------------


def test_only_the_results_change_in_the_text_of_a_table(place):
    place.write_text(ROWS + ALONE, encoding="utf-8")
    update(read_table(place), "first ones", status=clean)
    assert {path.name for path in place.parent.iterdir()} == {"table.toml", "short.mcap", "REPORT.md"}
    first = place.read_text()
    lines = [line for line in first.splitlines() if not line.startswith(("[recording.made]", "digest", "dynpf"))]
    assert lines == (ROWS + ALONE).splitlines()
    digests = [entry.made.digest for entry in read_table(place).rows if entry.made is not None]
    place.write_text(first.replace(digests[1], "0" * 64), encoding="utf-8")
    table = read_table(place)
    assert parts(table, table.rows[1]) == ("run",)
    assert check_part(table, table.rows[1], "run").verdict == "differs"
    assert [change.new.name for change in update(table, "control", status=clean)] == ["alone"]
    assert place.read_text() == first


def test_a_table_runs_scenarios_of_ones_own_and_code_only_if_it_is_allowed(place, monkeypatch):
    monkeypatch.setattr("sys.path", [*sys.path])
    folder = place.parent / "own"
    folder.mkdir()
    module, scenario = folder / "pull_of_a_table.py", folder / "mine.toml"
    code = (CHECKOUT / "examples" / "estimator" / "pull.py").read_text()
    marked = f"{code}\nfrom pathlib import Path\n\nPath(__file__).with_name('mark').touch()\n"
    module.write_text(marked, encoding="utf-8")
    text = (CHECKOUT / "examples" / "estimator" / "estimator.toml").read_text()
    scenario.write_text(text.replace('"pull:', '"pull_of_a_table:'), encoding="utf-8")
    row = ROWS.replace("landmark-room", "own/mine.toml").replace('nodes = ["estimator"]', "")
    place.write_text(row, encoding="utf-8")
    refused = read_table(place)
    find_code(refused)
    with pytest.raises(ScenarioError, match=r"a table of references runs no code .* --allow-code pull_of_a_table"):
        update(refused, "first ones", status=clean)
    assert not (folder / "mark").exists()
    allowed = read_table(place, allow_code=["pull_of_a_table"])
    update(allowed, "first ones", status=clean)
    assert (folder / "mark").exists()
    table = read_table(place, allow_code=["pull_of_a_table"])
    found = [check_part(table, table.rows[0], part) for part in parts(table, table.rows[0])]
    assert {one.verdict for one in found} == {"same"}
    assert "file" in {one.part for one in found}
    assert len(found) > 4, "every node of the run is replayed"
    scenario.write_text(scenario.read_text().replace("max_ticks", "state_digest_ticks = 5\nmax_ticks"))
    assert check_part(table, table.rows[0], "run").verdict == "differs"
    twin = place.parent / "other"
    twin.mkdir()
    (twin / module.name).touch()
    with pytest.raises(UsageError, match=r"pull_of_a_table is in .*other and in .*own"):
        find_code(read_table(place, [twin], ["pull_of_a_table"]))
