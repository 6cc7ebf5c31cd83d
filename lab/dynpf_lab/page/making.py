"""Makes the page of a recording, or of two, as a file; a page that cannot be made never fails a run."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dynpf_experiments.measures import measure
from dynpf_experiments.pictures.executed import executed_clouds
from dynpf_experiments.pictures.page import apart, run_picture
from dynpf_experiments.pictures.source import Budget
from dynpf_experiments.pictures.tracks import Clouds
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.schema import Scenario

from dynpf_lab.page.document import document, made_by

__all__ = ["make_page", "page_of"]

MOST_BYTES = 2_000_000
"""A page is at most so large: where a run is longer or richer, less of it is drawn."""

_MARK = "dynpf page"


def page_of(*recordings: Path) -> Path:
    """Return where the page of a recording lies, or of two: beside the first."""
    stem = "-and-".join(path.name.removesuffix(".mcap") for path in recordings)
    return recordings[0].with_name(f"{stem}.html")


def make_page(
    recordings: Sequence[Recording],
    path: Path,
    measures: Mapping[str, Any] | None = None,
    *,
    scenarios: Sequence[Scenario] = (),
) -> bool:
    """Write the page of one recording, or of two, unless it is there already; return whether it was written.

    ``measures`` are those of the first recording, where they are known. With the recordings' ``scenarios``, ready to
    run, all particles are drawn: the nodes that have them are executed again. Raises UsageError for a file that is
    there and is no page of dynpf's, and for one that cannot be written; a RecordingError for a damaged recording.
    """
    mark = f"{_MARK} {made_by()} {' '.join(_digest(recording.path) for recording in recordings)}"
    mark += " all particles" if scenarios else ""
    there = _mark_of(path)
    if there == mark:
        return False
    if there is not None and not there.startswith(_MARK):
        raise UsageError(f"{path}: the file exists and is no page of dynpf's; name another one with dynpf view -o")
    known = [measures or measure(recordings[0]), *(measure(recording) for recording in recordings[1:])]
    executed = [executed_clouds(*each, Budget()) for each in zip(recordings, scenarios, strict=bool(scenarios))]
    _write(path, _text(recordings, known, mark, executed or [[] for _ in recordings]))
    return True


def _text(
    recordings: Sequence[Recording],
    measures: Sequence[Mapping[str, Any]],
    mark: str,
    executed: Sequence[Sequence[Clouds]],
) -> str:
    """Return a page that is no larger than MOST_BYTES, by drawing as much as fits."""
    between = apart(*recordings) if len(recordings) == 2 else None
    budget = Budget() if len(recordings) == 1 else Budget().halved()
    while True:
        shown = zip(recordings, measures, executed, strict=True)
        pictures = [run_picture(each, of_run, budget, clouds) for each, of_run, clouds in shown]
        text = document(pictures, between, mark)
        if len(text.encode()) <= MOST_BYTES or budget == budget.halved():
            return text
        budget = budget.halved()


def _mark_of(path: Path) -> str | None:
    """Return what a page says of its making, "" for another file, None where there is none."""
    try:
        with path.open("rb") as file:
            lines = file.read(400).decode("utf-8", "replace").split("\n")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    line = lines[1] if len(lines) > 2 else ""
    return line.removeprefix("<!-- ").removesuffix(" -->") if line.startswith(f"<!-- {_MARK} ") else ""


def _digest(path: Path) -> str:
    """Return a digest of a recording's content and name, both of which its page shows."""
    with path.open("rb") as file:
        content = hashlib.file_digest(file, "sha256")
    content.update(os.fsencode(path.name))
    return content.hexdigest()


def _write(path: Path, text: str) -> None:
    """Write a file at once: whoever looks sees the old page or the new one."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        scratch.write_text(text, "utf-8")
        scratch.replace(path)
    except OSError as error:
        scratch.unlink(missing_ok=True)
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
