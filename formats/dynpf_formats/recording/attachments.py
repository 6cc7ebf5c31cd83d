"""The files that a scenario names, as attachments of a recording."""

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
from dynpf_protocol.json_text import read_json
from dynpf_protocol.landmarks import Landmark

from dynpf_formats.recording.header import Attachment

__all__ = [
    "FOLDER",
    "LANDMARKS",
    "attached",
    "attached_landmarks",
    "changed_files",
    "files_of",
    "foreign_attachments",
    "is_file",
    "landmarks_of",
]

FOLDER = "files/"
"""The folder of the attachments that a scenario names; those of a played log are beside it."""

LANDMARKS = "landmarks.json"
"""The attachment that holds an imported log's landmarks."""


def attached(name: str, data: bytes) -> Attachment:
    """Return a file that a scenario names as an attachment of a recording."""
    return Attachment(name=f"{FOLDER}{name}", media_type=_media_type(name), data=data)


def is_file(attachment: Attachment) -> bool:
    """Return whether an attachment is a file that a scenario names, or could name."""
    return attachment.name.startswith(FOLDER)


def files_of(attachments: Iterable[Attachment]) -> dict[str, bytes]:
    """Return the contents of the files among attachments, by the names that a scenario uses."""
    return {item.name.removeprefix(FOLDER): item.data for item in attachments if is_file(item)}


def changed_files(scenario: str, attachments: Iterable[Attachment]) -> list[str]:
    """Return a text for each file of a recorded scenario that is not attached, or is not the one of its SHA-256."""
    try:
        known = read_json(scenario, _Files).files
    except msgspec.DecodeError:
        return []  # an imported log has no scenario; whoever reads a scenario tells what is wrong with it
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in files_of(attachments).items()}
    texts = [f"the file {name!r} of the scenario is not attached" for name in known if name not in digests]
    return texts + [
        f"the attached file {name!r} is not the one of the run: its SHA-256 is {digests[name][:12]}, and was "
        f"{file.sha256[:12]}"
        for name, file in known.items()
        if name in digests and digests[name] != file.sha256
    ]


def foreign_attachments(scenario: str, attachments: Iterable[Attachment]) -> list[str]:
    """Return the names of attachments that a run of a recorded scenario does not have."""
    try:
        known = read_json(scenario, _Files)
    except msgspec.DecodeError:
        return []
    expected = {f"{FOLDER}{name}" for name in known.files} | ({LANDMARKS} if known.log_digest else set())
    return [item.name for item in attachments if item.name not in expected]


class _File(msgspec.Struct):
    sha256: str


class _Files(msgspec.Struct):
    files: dict[str, _File] = {}
    log_digest: str = ""  # of the log that the run plays, if it plays one


def attached_landmarks(landmarks: Sequence[Landmark]) -> Attachment:
    """Return the landmarks of a log as an attachment: a JSON list of id, x and y."""
    return Attachment(name=LANDMARKS, media_type="application/json", data=msgspec.json.encode(landmarks))


def landmarks_of(attachments: Iterable[Attachment]) -> tuple[Landmark, ...]:
    """Return the landmarks among attachments, none if there are none; raises msgspec.DecodeError."""
    data = next((item.data for item in attachments if item.name == LANDMARKS), b"[]")
    return read_json(data, tuple[Landmark, ...])


def _media_type(name: str) -> str:
    known = {".yaml": "application/yaml", ".png": "image/png", ".bmp": "image/bmp", ".pgm": "image/x-portable-graymap"}
    return known.get(Path(name).suffix.lower(), "application/octet-stream")
