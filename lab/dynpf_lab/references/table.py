"""The table of the reference recordings, and the files beside it."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path

import msgspec
from dynpf_protocol.errors import UsageError

__all__ = ["CHECKOUT", "Entry", "Made", "read_table", "recording_file", "render_table", "table_file"]

CHECKOUT = Path(__file__).parents[3]


class Made(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The result of the run, and the version that made it."""

    digest: str  # content digest
    dynpf: str  # version


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A row: the run, the nodes that it covers, and its purpose."""

    name: str
    scenario: str
    overrides: tuple[str, ...] = ()
    seed: int
    log: str = ""  # folder of the MRCLAM data set of the run, relative to the checkout: only the digest is kept
    nodes: tuple[str, ...]
    why: str
    made: Made | None = None


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    recording: tuple[Entry, ...] = ()


def table_file(checkout: Path) -> Path:
    """Return the path of the table."""
    return checkout / "recordings" / "table.toml"


def recording_file(checkout: Path, entry: Entry) -> Path:
    """Return the path of the recording of a row."""
    return checkout / "recordings" / f"{entry.name}.mcap"


def read_table(checkout: Path = CHECKOUT) -> tuple[Entry, ...]:
    """Return the rows of the table; raises UsageError outside of a checkout, and for an invalid table."""
    path = table_file(checkout)
    if not path.is_file():
        raise UsageError(f"{path}: no such file; reference recordings are not installed: call dynpf from a checkout")
    try:
        entries = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), _Table).recording
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise UsageError(f"{path}: {error}") from error
    names = [entry.name for entry in entries]
    if len(set(names)) != len(names):
        raise UsageError(f"{path}: two recordings have the same name")
    return entries


def render_table(entries: Sequence[Entry]) -> str:
    """Return the table as TOML."""
    lines = ["# The reference recordings. `dynpf references update` fills in the tables `made`; the rest is yours."]
    for entry in entries:
        lines += ["", "[[recording]]", *_keys(entry)]
        if entry.made is not None:
            lines += ["[recording.made]", *_keys(entry.made)]
    return "\n".join(lines) + "\n"


def _keys(row: Entry | Made) -> list[str]:
    defaults = {field.name: field.default for field in msgspec.structs.fields(row)}
    values = {name: getattr(row, name) for name in defaults if name != "made"}
    # JSON's numbers, strings and lists of strings are TOML's too.
    return [f"{name} = {json.dumps(value)}" for name, value in values.items() if value != defaults[name]]
