"""Checks reference recordings: the file, every node replayed from it, and the run made anew."""

import tempfile
from pathlib import Path
from typing import Literal

import msgspec

from protocol.errors import ProtocolError
from protocol.topics import TOPICS
from services.errors import DynpfError, UsageError
from services.nodes import build_node
from services.recording.diff import Difference, diff
from services.recording.digest import Key, content_digest, leaves
from services.recording.provenance import collect
from services.recording.reader import Recording, read_recording
from services.recording.scenario import recorded_scenario
from services.references.runs import has_data, resolve, run_anew
from services.references.table import CHECKOUT, Entry, Made, made_by, recording_file
from services.references.tolerance import Said, first_beyond, read_tolerances
from services.runners.replay import Mismatch, Replayed, replay_node

__all__ = ["FILE", "RUN", "Finding", "check_part", "parts", "same_platform"]

FILE = "file"
RUN = "run"

_ELSEWHERE = "recorded on another platform: counts, stateless nodes and the first ticks compared, the rest skipped"


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """What came of checking one part of a recording: the file, the run made anew, or a node."""

    recording: str
    part: str
    verdict: Literal["same", "differs", "skipped"]
    note: str = ""
    first: Mismatch | None = None


def parts(entry: Entry) -> tuple[str, ...]:
    """Return what there is to check of a recording."""
    if entry.log:
        return (RUN,)
    again = (RUN,) if resolve(entry).clock == "lockstep" else ()
    return (FILE, *entry.nodes, *again)


def same_platform(entry: Entry) -> bool:
    """Return whether this program runs on the platform that made the recording: bytes are promised only there."""
    return entry.made is not None and entry.made.platform == made_by(collect())


def check_part(entry: Entry, part: str, checkout: Path = CHECKOUT) -> Finding:
    """Check one of ``parts(entry)``. Whatever cannot be read or run is a difference, not an error."""
    try:
        if entry.made is None:
            raise UsageError("not recorded yet; dynpf references update makes it")
        if part == FILE:
            return _check_file(entry, entry.made, checkout)
        if part == RUN:
            return _check_run(entry, entry.made, checkout)
        return _check_node(entry, part, checkout)
    except (DynpfError, ProtocolError) as error:
        return Finding(recording=entry.name, part=part, verdict="differs", note=str(error))


def _check_file(entry: Entry, made: Made, checkout: Path) -> Finding:
    found = content_digest(_read(entry, checkout))
    if found == made.digest:
        return _finding(entry, FILE, None)
    text = f"content digest {found}, the table says {made.digest}"
    return Finding(recording=entry.name, part=FILE, verdict="differs", note=text)


def _check_node(entry: Entry, node: str, checkout: Path) -> Finding:
    recording = _read(entry, checkout)
    # The table says which run this is, and so which code: a file that names other code does not get it run.
    scenario = recorded_scenario(recording, allow_code=resolve(entry).user_code)
    exact = same_platform(entry)
    fresh = build_node(scenario, node)
    replayed = replay_node(recording, fresh, scenario.state_digest_ticks, keep=not exact)
    if not replayed.messages:
        return Finding(recording=entry.name, part=node, verdict="differs", note="said nothing: nothing was compared")
    if exact:
        return _finding(entry, node, replayed.mismatch)
    stateless = () if fresh.freeze() else (node,)
    old = {key: said for key, said in _said(recording).items() if key.node == node}
    new = _replayed(recording, replayed)
    return _finding(entry, node, first_beyond(old, new, read_tolerances(checkout), stateless), _ELSEWHERE)


def _check_run(entry: Entry, made: Made, checkout: Path) -> Finding:
    exact = same_platform(entry)
    if not has_data(checkout, entry):
        return Finding(recording=entry.name, part=RUN, verdict="skipped", note=f"{entry.log} is not there")
    if entry.log and not exact:
        note = "held by digest only, which another platform need not reproduce"
        return Finding(recording=entry.name, part=RUN, verdict="skipped", note=note)
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        anew = run_anew(checkout, entry, Path(folder) / "anew.mcap")
        if exact:
            digest = content_digest(anew)
            if digest == made.digest:
                return _finding(entry, RUN, None)
            first = None if entry.log else _first(diff(_read(entry, checkout), anew))
            note = f"content digest {digest}, the table says {made.digest}"
            return Finding(recording=entry.name, part=RUN, verdict="differs", note=note, first=first)
        tolerances = read_tolerances(checkout)
        old, new = (
            {key: one for key, one in _said(recording).items() if one.tick < tolerances.first_ticks}
            for recording in (_read(entry, checkout), anew)
        )
        return _finding(entry, RUN, first_beyond(old, new, tolerances), _ELSEWHERE)


def _read(entry: Entry, checkout: Path) -> Recording:
    return read_recording(recording_file(checkout, entry))


def _finding(entry: Entry, part: str, first: Mismatch | None, note: str = "") -> Finding:
    return Finding(
        recording=entry.name, part=part, verdict="same" if first is None else "differs", note=note, first=first
    )


def _first(difference: Difference) -> Mismatch | None:
    one = difference.first
    if one is None:
        return None
    return Mismatch(one.node, one.topic, -1 if one.tick is None else one.tick, one.sequence, one.field, one.a, one.b)


def _said(recording: Recording) -> dict[Key, Said]:
    return {key: Said(leaf.tick, leaf.stamp_ns, leaf.record.payload) for key, leaf in leaves(recording).items()}


def _replayed(recording: Recording, replayed: Replayed) -> dict[Key, Said]:
    starts = {boot: start for start, boot in enumerate(recording.boots(replayed.node))}
    return {
        Key(replayed.node, one.topic, starts[boot], one.envelope.sequence): Said(
            one.envelope.tick, one.envelope.stamp_ns, one.payload
        )
        for boot, sent, _ in replayed.executed
        for one in sent
        if TOPICS[one.topic].compared
    }
