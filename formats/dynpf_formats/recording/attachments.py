"""The files that a scenario names, as attachments of a recording."""

from pathlib import Path

from dynpf_formats.recording.header import Attachment

__all__ = ["FOLDER", "attached", "is_file"]

FOLDER = "files/"
"""The folder of the attachments that a scenario names; those of a played log are beside it."""


def attached(name: str, data: bytes) -> Attachment:
    """Return a file that a scenario names as an attachment of a recording."""
    return Attachment(name=f"{FOLDER}{name}", media_type=_media_type(name), data=data)


def is_file(attachment: Attachment) -> bool:
    """Return whether an attachment is a file that a scenario names, or could name."""
    return attachment.name.startswith(FOLDER)


def _media_type(name: str) -> str:
    known = {".yaml": "application/yaml", ".png": "image/png", ".bmp": "image/bmp", ".pgm": "image/x-portable-graymap"}
    return known.get(Path(name).suffix.lower(), "application/octet-stream")
