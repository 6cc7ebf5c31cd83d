"""The files that a scenario names, as attachments of a recording."""

from collections.abc import Iterable
from pathlib import Path

from dynpf_formats.recording.header import Attachment

__all__ = ["FOLDER", "attached", "files_of", "is_file"]

FOLDER = "files/"
"""The folder of the attachments that a scenario names; those of a played log are beside it."""


def attached(name: str, data: bytes) -> Attachment:
    """Return a file that a scenario names as an attachment of a recording."""
    return Attachment(name=f"{FOLDER}{name}", media_type=_media_type(name), data=data)


def is_file(attachment: Attachment) -> bool:
    """Return whether an attachment is a file that a scenario names, or could name."""
    return attachment.name.startswith(FOLDER)


def files_of(attachments: Iterable[Attachment]) -> dict[str, bytes]:
    """Return the contents of the files among attachments, by the names that a scenario uses."""
    return {item.name.removeprefix(FOLDER): item.data for item in attachments if is_file(item)}


def _media_type(name: str) -> str:
    known = {".yaml": "application/yaml", ".png": "image/png", ".bmp": "image/bmp", ".pgm": "image/x-portable-graymap"}
    return known.get(Path(name).suffix.lower(), "application/octet-stream")
