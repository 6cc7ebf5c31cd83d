"""What the matrix has found, as text for a person."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from dynpf_formats.recording.diff import FirstDifference

from checks.machines.runs import Difference, Outcome

__all__ = ["Row", "changed_controls", "row_of", "table", "verdict"]


class Row(NamedTuple):
    """A setting and what came of it."""

    outcome: Outcome
    changed: tuple[str, ...]  # controls that came out otherwise than by default
    different: tuple[Difference, ...]
    jobs: int
    absent: int

    @property
    def effective(self) -> bool:
        """Return whether a control shows that the setting chose other kernels."""
        return any(control in self.changed for control in self.outcome.setting.controls)


def changed_controls(default: Outcome, outcome: Outcome) -> tuple[str, ...]:
    """Return the controls that differ from the default's."""
    if default.told is None or outcome.told is None:
        return ()
    here = outcome.told.controls
    return tuple(name for name, digest in default.told.controls.items() if here.get(name) != digest)


def row_of(default: Outcome, outcome: Outcome, different: Iterable[Difference]) -> Row:
    """Return the row of an outcome."""
    absent = sum(one.absent for one in outcome.done.values())
    return Row(outcome, changed_controls(default, outcome), tuple(different), len(default.done), absent)


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a table: setting, controls that changed, jobs that are the same, the first that is not."""
    cells = [("setting", "control", "same", "first difference", "s")]
    cells += [(row.outcome.setting.name, *_cells(row), f"{row.outcome.seconds:.0f}") for row in rows]
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in cells]
    return "\n".join((lines[0], "-" * len(lines[0]), *lines[1:]))


def _cells(row: Row) -> tuple[str, str, str]:
    expected = row.outcome.setting.controls
    changed = ", ".join(name for name in row.changed if name in expected) or ("no effect here" if expected else "-")
    if row.outcome.told is None:
        return "not seen", "failed", row.outcome.failure
    first = row.different[0] if row.different else None
    told = "" if first is None else f"{first.job}: {_place(first)}"
    return changed, f"{row.jobs - len(row.different)}/{row.jobs}", told


def _place(one: Difference) -> str:
    if not one.where:
        return one.note
    first = one.where[0]
    return f"{first.node} {first.topic}, tick {first.tick}, {first.field}"


def details(row: Row) -> list[str]:
    """Return a line for each job that differs and one for each of its nodes, with both values."""
    lines = []
    for one in row.different:
        lines.append(f"  {one.job}: {one.note}" if one.note else f"  {one.job}")
        lines += [f"    {_line(first)}" for first in one.where]
    return lines


def _line(first: FirstDifference) -> str:
    where = f"{first.node:<11} {first.topic}, tick {first.tick}, message {first.sequence}, {first.field}"
    return f"{where}: expected {first.a!r}, came out {first.b!r}"


def verdict(rows: Sequence[Row]) -> str:
    """Return what follows from all rows in one sentence."""
    different = [row.outcome.setting.name for row in rows if row.different or row.outcome.failure]
    proving = sum(row.effective for row in rows)
    if different:
        return f"Different: {len(different)} of {len(rows)} settings: {', '.join(different)}"
    return f"The same bytes under all settings; {proving} of them have an effect here and prove something"
