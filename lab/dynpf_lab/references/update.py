"""Records the reference recordings again, all of them or none, and reports the changes."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dynpf_experiments.measures import measure
from dynpf_formats.recording.diff import FirstDifference, first_field
from dynpf_formats.recording.digest import Leaf, content_digest, leaves, states
from dynpf_formats.recording.provenance import collect
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.errors import DynpfError, UsageError
from dynpf_services.scenario.schema import resolved_json

from dynpf_lab.references.check import FILE, check_part, parts
from dynpf_lab.references.runs import has_data, rerun_entry, resolve
from dynpf_lab.references.table import Entry, Made, Table, with_made

__all__ = ["MAX_BYTES", "Change", "first_differences", "git_status", "update"]

MAX_BYTES = 1_000_000


class Change(NamedTuple):
    """The change of a recording; ``first`` has the first difference of each node and topic, a old and b new."""

    old: Entry
    new: Entry
    first: tuple[FirstDifference, ...]
    measures: tuple[tuple[str, Any, Any], ...]  # name, old, new
    note: str = ""


def git_status(table: Table) -> str:
    """Return git's status of the checkout that has the table, except for what ``update`` and Python write.

    Outside of a checkout there is nothing that could be uncommitted. Raises UsageError without git.
    """
    written = (table.path, table.report, *map(table.recording, table.rows))
    excluded = [*(f":(exclude,literal){path.name}" for path in written), ":(top,exclude,glob)**/__pycache__/**"]
    command = ["git", "status", "--porcelain", "--untracked-files=all", "--", ":/", *excluded]
    folder = table.path.parent
    try:
        environment = {**os.environ, "LC_ALL": "C"}
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)
    except FileNotFoundError:
        raise UsageError("git is not installed; it is needed to check that the checkout is clean") from None
    if done.returncode and "not a git repository" not in done.stderr:
        raise UsageError(f"{folder}: git status failed: {done.stderr.strip()}")
    return done.stdout


def update(
    table: Table,
    reason: str,
    *,
    status: Callable[[Table], str] = git_status,
    show: Callable[[str], None] = lambda _: None,
) -> list[Change]:
    """Record every run of the table again, replace changed recordings, table and report, and return the changes.

    A realtime run is never the same twice: its recording stays as long as it replays exactly. Raises UsageError without
    a reason, in a checkout with uncommitted changes, and where the data of a run is absent; DynpfError if a run fails.
    Nothing is written then.
    """
    if not reason.strip():
        raise UsageError("--reason: say in a sentence why what the recordings hold may change")
    dirty = status(table).splitlines()
    if dirty:
        more = f" and {len(dirty) - 3} more" if len(dirty) > 3 else ""
        listed = ", ".join(line[3:] for line in dirty[:3])
        raise UsageError(f"{table.path.parent}: has uncommitted changes: {listed}{more}; commit them first")
    absent = [table.log(entry) for entry in table.rows if not has_data(table, entry)]
    if absent:
        raise UsageError(f"{absent[0]}: is not there; all recordings are made again, or none")
    changes, new_entries = [], []
    with tempfile.TemporaryDirectory(prefix="dynpf-") as temporary:
        folder = Path(temporary)
        for entry in table.rows:
            show(entry.name)
            change = _make(table, entry, folder / f"{entry.name}.mcap")
            changes += [change] if change is not None else []
            new_entries.append(change.new if change is not None else entry)
        if changes:
            text = with_made(table, new_entries)
            for change in changes:
                if change.new.kept:
                    shutil.copyfile(folder / f"{change.new.name}.mcap", table.recording(change.new))
            table.path.write_text(text, encoding="utf-8")
            table.report.write_text(_report(reason, changes, new_entries), encoding="utf-8")
    return changes


def _make(table: Table, entry: Entry, path: Path) -> Change | None:
    """Return the change of a recording, or None."""
    old, note = _old(table, entry)
    realtime = entry.kept and resolve(table, entry).clock == "realtime"
    if realtime and old is not None and _still_replays(table, entry, old):
        return None
    rerun = rerun_entry(table, entry, path)
    size = path.stat().st_size
    if size > MAX_BYTES and entry.kept:
        raise UsageError(
            f"{entry.name}: {size} bytes; a reference recording has at most {MAX_BYTES}: make the run shorter "
            '(overrides = ["max_ticks=N"]), or keep its digest alone (keep = false)'
        )
    digest = content_digest(rerun)
    if entry.made is not None and entry.made.digest == digest and (not entry.kept or not note):
        return None
    made = Made(digest=digest, dynpf=collect().dynpf_version)
    before = measure(old) if old is not None else {}
    after = measure(rerun)
    measures = tuple(
        (name, before.get(name), after.get(name))
        for name in {**before, **after}
        if before.get(name) != after.get(name) and name != "content_digest"
    )
    first = tuple(first_differences(old, rerun)) if old is not None and not realtime else ()
    if realtime and old is not None:
        first, note = (
            _replay_differences(table, entry),
            "realtime: the differences are those of replaying the old one",
        )
    return Change(entry, msgspec.structs.replace(entry, made=made), first, measures, note)


def _old(table: Table, entry: Entry) -> tuple[Recording | None, str]:
    """Return the old recording, or None and the reason why it cannot be compared."""
    path = table.recording(entry)
    if entry.made is None:
        return None, "new"
    if not entry.kept:
        return None, "held by digest only"
    try:
        old = read_recording(path)
    except DynpfError as error:
        reason = str(error).removeprefix(f"{path}: ")  # the report does not depend on the checkout's path
        return None, f"the old one cannot be read: {reason}"
    return old, "" if content_digest(old) == entry.made.digest else "the old file is not that of the table"


def _still_replays(table: Table, entry: Entry, old: Recording) -> bool:
    same = all(check_part(table, entry, part).verdict == "same" for part in parts(table, entry))
    return same and old.header.scenario == resolved_json(resolve(table, entry))


def _replay_differences(table: Table, entry: Entry) -> tuple[FirstDifference, ...]:
    findings = [check_part(table, entry, part).first for part in parts(table, entry) if part != FILE]
    return tuple(
        FirstDifference(
            node=mismatch.node,
            topic=mismatch.topic,
            tick=mismatch.tick,
            sequence=mismatch.sequence,
            field=mismatch.field,
            a=mismatch.recorded,
            b=mismatch.replayed,
        )
        for mismatch in findings
        if mismatch is not None
    )


def first_differences(a: Recording, b: Recording) -> list[FirstDifference]:
    """Return, for each node and topic, the first message that differs, by tick and sequence; then the states."""
    left, right = leaves(a), leaves(b)
    found: dict[tuple[str, str], FirstDifference] = {}
    ticks = {key: min(side[key].tick for side in (left, right) if key in side) for key in {**left, **right}}
    for key in sorted(ticks, key=lambda key: (ticks[key], key)):
        values = None if (key.node, key.topic) in found else _values(left.get(key), right.get(key))
        if values is not None:
            found[key.node, key.topic] = _difference(key.node, key.topic, ticks[key], key.sequence, values)
    old_states, new_states = states(a), states(b)
    for state in sorted({**old_states, **new_states}):
        old, new = (side.get(state, (-1, "missing")) for side in (old_states, new_states))
        topic = f"journal/{state.node}"
        if old != new and (state.node, topic) not in found:
            values = ("state", old[1], new[1])
            found[state.node, topic] = _difference(state.node, topic, max(old[0], new[0]), state.number, values)
    return list(found.values())


def _values(a: Leaf | None, b: Leaf | None) -> tuple[str, Any, Any] | None:
    if a is None or b is None:
        return "message", "missing" if a is None else "present", "missing" if b is None else "present"
    if (a.tick, a.stamp_ns) != (b.tick, b.stamp_ns):
        return ("tick", a.tick, b.tick) if a.tick != b.tick else ("stamp_ns", a.stamp_ns, b.stamp_ns)
    return None if a.digest == b.digest else first_field(a.record.payload, b.record.payload)


def _difference(node: str, topic: str, tick: int, sequence: int, values: tuple[str, Any, Any]) -> FirstDifference:
    field, a, b = values
    return FirstDifference(node=node, topic=topic, tick=tick, sequence=sequence, field=field, a=a, b=b)


def _report(reason: str, changes: Sequence[Change], entries: Iterable[Entry]) -> str:
    provenance = collect()
    packages = ", ".join(f"{name} {version}" for name, version in sorted(provenance.packages.items()))
    platform = ", ".join(f"{name} {value}" for name, value in provenance.platform.items())
    changed = {change.new.name for change in changes}
    unchanged = ", ".join(entry.name for entry in entries if entry.name not in changed) or "none"
    lines = [
        "# What changed in the reference recordings",
        "",
        f"Reason: {reason.strip()}",
        "",
        f"Made by dynpf {provenance.dynpf_version}, code {provenance.code_digest[:12]}; {packages}.",
        f"Platform: {platform}.",
        "",
        f"Unchanged: {unchanged}.",
    ]
    for change in changes:
        lines += ["", f"## {change.new.name}", "", *_change_lines(change)]
    return "\n".join(lines) + "\n"


def _change_lines(change: Change) -> list[str]:
    lines = [f"{change.note[:1].upper()}{change.note[1:]}.", ""] if change.note else []
    assert change.new.made is not None
    old = msgspec.structs.asdict(change.old.made) if change.old.made is not None else {}
    new = msgspec.structs.asdict(change.new.made)
    lines += _rows(("", "old", "new"), [(name, old.get(name, "none"), value) for name, value in new.items()])
    if change.first:
        rows = [(f.node, f.topic, f.tick, f.sequence, f.field, f.a, f.b) for f in change.first]
        lines += ["", *_rows(("node", "topic", "tick", "sequence", "first field", "old", "new"), rows)]
    if change.measures:
        metrics = [(name, a, b, _delta(a, b)) for name, a, b in change.measures]
        lines += ["", *_rows(("measure", "old", "new", "change"), metrics)]
    return lines


def _delta(old: Any, new: Any) -> str:
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (old, new))
    return f"{new - old:+.6g}" if numbers else ""


def _rows(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    table = [header, ["---"] * len(header), *rows]
    return [
        "| " + " | ".join("" if cell is None else str(cell).replace("|", "\\|") for cell in row) + " |" for row in table
    ]
