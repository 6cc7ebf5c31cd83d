"""The files that a scenario names, as attachments of a recording."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import zstandard
from dynpf_protocol.json_text import read_json
from dynpf_protocol.landmarks import Landmark

from dynpf_formats.recording.errors import RecordingError
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

COMPRESSED = "application/zstd"
"""The media type of a file that is compressed, whatever it is."""

LARGEST_PLAIN = 2**24  # bytes of a file that is attached as it is
LARGEST_FILE = 2**28  # bytes, unpacked: more than the cells of the largest map
LARGEST_WINDOW = 2**23  # bytes; what ``attached`` makes needs 2 MiB
PIECE = 2**20

LANDMARKS = "landmarks.json"
"""The attachment that holds an imported log's landmarks."""


def attached(name: str, data: bytes) -> Attachment:
    """Return a file that a scenario names as an attachment of a recording; a large one is compressed."""
    name, media_type = f"{FOLDER}{name}", _media_type(name)
    if len(data) > LARGEST_PLAIN:
        media_type, data = COMPRESSED, zstandard.ZstdCompressor(level=3).compress(data)
    return Attachment(name=name, media_type=media_type, data=data)


def is_file(attachment: Attachment) -> bool:
    """Return whether an attachment is a file that a scenario names, or could name."""
    return attachment.name.startswith(FOLDER)


def files_of(attachments: Iterable[Attachment]) -> dict[str, bytes]:
    """Return the contents of the files among attachments, by the names that a scenario uses.

    Raises RecordingError for one that cannot be unpacked.
    """
    return {item.name.removeprefix(FOLDER): b"".join(_content(item)) for item in attachments if is_file(item)}


def _content(item: Attachment) -> Iterator[bytes]:
    """Yield the content of a file piece by piece; raises RecordingError if it cannot be unpacked."""
    if item.media_type != COMPRESSED:
        yield item.data
        return
    try:
        size = zstandard.get_frame_parameters(item.data).content_size
        if not 0 < size <= LARGEST_FILE:
            raise RecordingError(f"attachment {item.name!r}: claims {size} bytes; expected 1 to {LARGEST_FILE}")
        with zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW).stream_reader(item.data) as stream:
            for done in range(0, size, PIECE):
                if len(piece := stream.read(min(PIECE, size - done))) != min(PIECE, size - done):
                    raise RecordingError(f"attachment {item.name!r}: ends before the {size} bytes that it claims")
                yield piece
    except zstandard.ZstdError as error:
        raise RecordingError(f"attachment {item.name!r}: cannot be unpacked: {error}") from error


def _digest(item: Attachment) -> str:
    digest = hashlib.sha256()
    for piece in _content(item):
        digest.update(piece)
    return digest.hexdigest()


def changed_files(scenario: str, attachments: Iterable[Attachment]) -> list[str]:
    """Return a text for each file of a recorded scenario that is not attached, or is not the one of its SHA-256."""
    try:
        known = read_json(scenario, _Files).files
    except msgspec.DecodeError:
        return []  # an imported log has no scenario; whoever reads a scenario tells what is wrong with it
    try:
        digests = {item.name.removeprefix(FOLDER): _digest(item) for item in attachments if is_file(item)}
    except RecordingError as error:
        return [str(error)]
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
