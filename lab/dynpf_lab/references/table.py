"""Tables of reference recordings, and the files beside them."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from json import dumps
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from dynpf_protocol.errors import UsageError

__all__ = ["CHECKOUT", "REPOSITORY", "Entry", "Made", "Table", "read_table", "with_made"]

CHECKOUT = Path(__file__).parents[3]

REPOSITORY = CHECKOUT / "recordings" / "table.toml"
"""dynpf's own table, in a checkout."""

_ROW = re.compile(r"^[ \t]*\[\[\s*recording\s*\]\].*$", re.MULTILINE)
_MADE = re.compile(r"\n*^[ \t]*\[\s*recording\.made\s*\].*$(\n[ \t]*(digest|dynpf)[ \t]*=.*$)*", re.MULTILINE)


class Made(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The result of the run, and the version that made it."""

    digest: str  # content digest
    dynpf: str  # version


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A row: the run, the nodes that it covers, and its purpose."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    scenario: str  # a name, or a file
    overrides: tuple[str, ...] = ()
    seed: int
    log: str = ""  # the log that the run plays, an imported one or a folder of MRCLAM: then only the digest is kept
    keep: bool = True  # whether the recording is kept beside the table, and not its digest alone
    nodes: tuple[str, ...] = ()  # the nodes that are replayed; none: every node of the run
    why: str = ""
    made: Made | None = None

    @property
    def kept(self) -> bool:
        """Whether there is a recording beside the table."""
        return self.keep and not self.log


class _Rows(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    recording: tuple[Entry, ...] = ()


class Table(NamedTuple):
    """A table and its file; paths in it are relative to the file's folder, where recordings and report lie, too.

    ``code`` has folders in which modules of the scenarios are looked for, ``allow_code`` the modules that may be run.
    """

    path: Path
    rows: tuple[Entry, ...]
    code: tuple[Path, ...] = ()
    allow_code: frozenset[str] = frozenset()

    @property
    def report(self) -> Path:
        """The path of the report on the last update."""
        return self.path.parent / "REPORT.md"

    def recording(self, entry: Entry) -> Path:
        """Return the path of the recording of a row."""
        return self.path.parent / f"{entry.name}.mcap"

    def log(self, entry: Entry) -> Path:
        """Return the path of the log of a row that has one."""
        return self.path.parent / entry.log

    def scenario(self, entry: Entry) -> str:
        """Return the name of the scenario of a row, or the path of its file."""
        path = Path(entry.scenario)
        named = path.suffix not in {".toml", ".json"} and path.parent == Path()
        return entry.scenario if named else str(self.path.parent.absolute() / path)


def read_table(path: Path = REPOSITORY, code: Iterable[Path] = (), allow_code: Iterable[str] = ()) -> Table:
    """Return a table; raises UsageError if there is none, and for an invalid one."""
    if not path.is_file():
        own = "; dynpf's own references are not installed: call dynpf from a checkout, or name a table with --table"
        raise UsageError(f"{path}: no such file{own if path == REPOSITORY else ''}")
    try:
        rows = _rows(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise UsageError(f"{path}: {error}") from error
    names = [entry.name for entry in rows]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise UsageError(f"{path}: two recordings have the name {twice!r}")
    return Table(path, rows, tuple(code), frozenset(allow_code))


def _rows(text: str) -> tuple[Entry, ...]:
    return msgspec.convert(tomllib.loads(text), _Rows).recording


def with_made(table: Table, rows: Sequence[Entry]) -> str:
    """Return the text of a table with ``made`` as in ``rows``, and all else as its author wrote it.

    Raises UsageError if its rows are not written as ``[[recording]]``.
    """
    text = table.path.read_text(encoding="utf-8")
    heads = [match.start() for match in _ROW.finditer(text)]
    pieces = [text[start:end] for start, end in zip(heads, [*heads[1:], len(text)], strict=True)]
    changed = text[: heads[0]] if heads else text
    for piece, row in zip(pieces, rows, strict=False):
        changed += piece if row.made is None else _with_made(piece, row.made)
    try:
        sound = _rows(changed) == tuple(rows)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError):
        sound = False
    if not sound:
        raise UsageError(f"{table.path}: the digests cannot be put in; write each row as a table [[recording]]")
    return changed


def _with_made(piece: str, made: Made) -> str:
    """Return the text of a row with other results, before the blank lines and comments that lead to the next row."""
    values = "\n".join(f"{name} = {dumps(value)}" for name, value in msgspec.structs.asdict(made).items())
    bare = _MADE.sub("", piece)
    lines = bare.splitlines()
    last = max(index for index, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#"))
    rest = "".join(f"{line}\n" for line in lines[last + 1 :])
    return "\n".join(lines[: last + 1]) + f"\n[recording.made]\n{values}\n{rest}"
