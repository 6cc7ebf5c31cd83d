"""What of a scenario travels in a recording beside its text, and how a scenario comes out of a recording again."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from services.recording.header import Attachment
from services.recording.reader import Recording
from services.scenario import Scenario, override_resolved, with_what_it_names

__all__ = ["FOLDER", "attached", "attachments_of", "is_file", "recorded_scenario"]

FOLDER = "files/"
"""Where the attachments are that a scenario names; those of a played log are beside it."""


def attachments_of(scenario: Scenario, others: Iterable[Attachment] = ()) -> tuple[Attachment, ...]:
    """Return what a recording of ``scenario`` has attached: the files that it names, and ``others``."""
    named = [attached(name, file.data) for name, file in sorted(scenario.files.items())]
    return (*(one for one in others if not is_file(one)), *named)


def recorded_scenario(recording: Recording, overrides: Sequence[str] = ()) -> Scenario:
    """Return the scenario of a recording, ready to be run again: its files with their content, and the user's modules
    with the digests that they have here and now.

    Raises ScenarioError for an override that does not fit, and for a module that is not there.
    """
    contents = {one.name.removeprefix(FOLDER): one.data for one in recording.attachments if is_file(one)}
    where = str(recording.path)
    scenario = override_resolved(recording.header.scenario, overrides, where)
    files = {name: msgspec.structs.replace(file, data=contents.get(name, b"")) for name, file in scenario.files.items()}
    scenario = msgspec.structs.replace(scenario, files=files)
    return with_what_it_names(scenario, where, lambda path: Path(path).read_bytes())


def attached(name: str, data: bytes) -> Attachment:
    """Return a file that a scenario names as it travels in a recording."""
    return Attachment(name=f"{FOLDER}{name}", media_type=_media_type(name), data=data)


def is_file(attachment: Attachment) -> bool:
    """Return whether an attachment is a file that a scenario names, or would name."""
    return attachment.name.startswith(FOLDER)


def _media_type(name: str) -> str:
    known = {".yaml": "application/yaml", ".png": "image/png", ".bmp": "image/bmp", ".pgm": "image/x-portable-graymap"}
    return known.get(Path(name).suffix.lower(), "application/octet-stream")
