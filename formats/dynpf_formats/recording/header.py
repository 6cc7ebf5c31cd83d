"""Metadata of a recording: the header at the start, attachments, and how the run ended.

Header and end are stored as MCAP metadata records. MCAP protects chunks by a checksum, but not these; so each carries
the SHA-256 of its own entries, which can be checked even in a file that is truncated before its last checksum. The end
holds digests of all the rest and, over them and all else that it says, the seal, which stands for the whole run.
"""

import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import msgspec
from dynpf_protocol.control import Outcome
from dynpf_protocol.messages import Gap
from dynpf_protocol.version import SCHEMA_VERSION

__all__ = [
    "PROFILE",
    "RUN",
    "RUN_END",
    "Attachment",
    "NodeEnd",
    "Provenance",
    "RunEnd",
    "RunHeader",
    "SealedAttachment",
    "SealedChannel",
    "as_entries",
    "checksum",
    "checksum_is_broken",
    "from_entries",
    "seal_of",
]

PROFILE = "dynpf"
"""MCAP profile of a recording."""

RUN = "run"
RUN_END = "run_end"

_CHECKSUM = "sha256"
_SEAL_LABEL = "dynpf seal"  # sets what it begins apart from other digests


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """What made a run: program, packages and platform; see ``dynpf_formats.recording.provenance.collect``."""

    dynpf_version: str
    code_digest: str  # SHA-256 over the sources of dynpf's packages
    packages: dict[str, str]  # distribution -> version
    platform: dict[str, str]  # the platform fingerprint


class RunHeader(msgspec.Struct, frozen=True, kw_only=True):
    """How to repeat the run. ``scenario`` is the resolved scenario as JSON; ``writes`` is empty for an imported log."""

    scenario: str
    seed: int
    provenance: Provenance
    writes: dict[str, tuple[str, ...]] = {}  # node, in tick order -> its topics
    clock: str = "lockstep"  # or "realtime"
    schema_version: int = SCHEMA_VERSION


class Attachment(msgspec.Struct, frozen=True, kw_only=True):
    """A file inside the recording, such as a map."""

    name: str
    media_type: str
    data: bytes


class NodeEnd(NamedTuple):
    """How far the journal of a node goes."""

    steps: int
    tick: int  # of its last entry
    last: bool  # whether that was the node's last step
    chain: str  # chain value of that entry


class SealedChannel(NamedTuple):
    """A source, and the SHA-256 over its schema, sequence numbers, logical stamps and payloads, in the file's order."""

    topic: str
    node: str
    boot: str
    digest: str


class SealedAttachment(NamedTuple):
    """An attachment, and the SHA-256 of its content."""

    name: str
    media_type: str
    digest: str


class RunEnd(msgspec.Struct, frozen=True, kw_only=True):
    """How a run ended, by its recorder, and what it seals: counts, journals, digests of everything in the file."""

    complete: bool
    reason: str
    outcome: str  # why the last step of a complete run was the last: Outcome of dynpf_protocol.control, or ""
    counts: dict[str, int]  # topic -> messages
    gaps: tuple[Gap, ...]  # sequence numbers never received; the first 1000 ranges
    missing: int  # how many sequence numbers were never received
    duplicates: int  # messages received again
    late: int  # messages received after a later one
    unresolved: int  # messages that the journal refers to and that were never received
    nodes: dict[str, NodeEnd]
    channels: tuple[SealedChannel, ...]  # in the order in which they appear
    order: str  # SHA-256 over the publish times and the order of all messages, neither of which is compared
    header: str  # SHA-256 of the metadata of the run
    attachments: tuple[SealedAttachment, ...]
    seal: str = ""  # seal_of this end

    @property
    def stopped(self) -> bool:
        """Whether a complete run ended because somebody stopped it, though its task and its time were not over."""
        return self.complete and self.outcome == Outcome.STOPPED


_T = TypeVar("_T", RunHeader, RunEnd)


def seal_of(end: RunEnd) -> str:
    """Return the seal of a run: a SHA-256 over all that its end says, and by that over everything in the file."""
    said = {name: getattr(end, name) for name in end.__struct_fields__ if name != "seal"}
    return hashlib.sha256(msgspec.json.encode([_SEAL_LABEL, said], order="sorted")).hexdigest()


def as_entries(record: RunHeader | RunEnd) -> dict[str, str]:
    """Return ``record`` as the entries of a metadata record: text as it is, other values as JSON, and the checksum."""
    fields = {name: getattr(record, name) for name in record.__struct_fields__}
    entries = {name: value if isinstance(value, str) else _json(value) for name, value in fields.items()}
    if isinstance(record, RunHeader):
        entries["dynpf_version"] = record.provenance.dynpf_version  # a separate entry, for readers of other versions
    return {**entries, _CHECKSUM: checksum(entries)}


def checksum_is_broken(entries: Mapping[str, str]) -> bool:
    """Return whether the checksum does not match the entries of a metadata record."""
    return entries.get(_CHECKSUM) != checksum({key: value for key, value in entries.items() if key != _CHECKSUM})


def from_entries(entries: Mapping[str, str], kind: type[_T]) -> _T:
    """Return the record with these entries; raises ValueError if they are damaged, or not those of ``as_entries``."""
    if checksum_is_broken(entries):
        raise ValueError("its checksum does not match")
    known = msgspec.structs.fields(kind)
    missing = [field.name for field in known if field.required and field.name not in entries]
    if missing:
        raise ValueError(f"{missing[0]} is missing")
    types = {field.name: field.type for field in known if field.name in entries}
    fields = {
        name: entries[name] if expected is str else msgspec.json.decode(entries[name], type=expected)
        for name, expected in types.items()
    }
    record = msgspec.convert(fields, kind)
    if as_entries(record) != entries:
        raise ValueError("its entries are not as dynpf writes them")
    return record


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()


def checksum(entries: Mapping[str, str]) -> str:
    """Return the SHA-256 of the entries of a metadata record."""
    return hashlib.sha256(msgspec.json.encode(dict(entries), order="sorted")).hexdigest()
