"""The measures of a run as a table with units, and those of two runs as before, after and the change in percent."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dynpf_experiments.pictures.figures import figures

__all__ = ["before_and_after", "changes_of", "table_of"]

_SKIPPED = frozenset({"content_digest"})


def table_of(measures: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table: the words of each measure, its value, its unit, and what it is judged by.

    Where a run has several estimators, each has a column.
    """
    several = measures.get("estimators")
    if not isinstance(several, Mapping):
        return _aligned(
            [(row.label, row.value, row.unit, _judged(row.interval)) for row in figures(measures)], right=(1,)
        )
    columns = {str(name): {row.label: row for row in figures(each)} for name, each in several.items()}
    named = {label: row.unit for column in columns.values() for label, row in column.items()}
    rows: list[tuple[str, ...]] = [("", *columns, "")]
    for label, unit in named.items():
        cells = (column[label].value if label in column else "-" for column in columns.values())
        rows.append((label, *cells, unit))
    shared = {name: value for name, value in measures.items() if all(name not in each for each in several.values())}
    rows += [(row.label, row.value, *("" for _ in list(columns)[1:]), row.unit) for row in figures(shared)]
    return _aligned(rows, right=range(1, len(columns) + 1))


def changes_of(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each measure before and after, and its change in percent where there is one, else None."""
    names = [name for name in {**before, **after} if name not in _SKIPPED]
    return {
        name: {
            "before": before.get(name),
            "after": after.get(name),
            "change_percent": _change(before.get(name), after.get(name)),
        }
        for name in names
    }


def before_and_after(
    changes: Mapping[str, Mapping[str, Any]], heads: tuple[str, str] = ("before", "after")
) -> list[str]:
    """Return the lines of a table of what ``changes_of`` returns, with units; those of estimators by their names."""
    rows: list[tuple[str, ...]] = [("", *heads, "", "change")]
    for name, row in changes.items():
        left, right = row["before"], row["after"]
        if isinstance(left, Mapping) or isinstance(right, Mapping):
            inner = changes_of(_flat(left), _flat(right))
            rows += [_row(f"{name}.{key}", each) for key, each in inner.items()]
        else:
            rows.append(_row(name, row))
    return _aligned(rows, right=(1, 2, 4))


def _row(name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    left, right = row["before"], row["after"]
    change = "" if row["change_percent"] is None else f"{row['change_percent']:+.1f} %"
    last = name.rpartition(".")[2]
    shown = [figures({last: value}) for value in (left, right)]
    known = next((one[0] for one in shown if one), None)
    if known is None:
        return (name, _cell(left), _cell(right), "", change)
    label = known.label if last == name else f"{name.rpartition('.')[0].removeprefix('estimators.')}: {known.label}"
    return (label, *(one[0].value if one else "-" for one in shown), known.unit, change)


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Return what is in tables inside a measure, by dotted names."""
    if not isinstance(value, Mapping):
        return {}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= _flat(inner, f"{prefix}{key}.") if isinstance(inner, Mapping) else {f"{prefix}{key}": inner}
    return found


def _change(before: Any, after: Any) -> float | None:
    numbers = [value for value in (before, after) if isinstance(value, int | float) and not isinstance(value, bool)]
    if len(numbers) < 2 or not all(map(math.isfinite, numbers)) or before == 0:
        return None
    return round(100 * (numbers[1] - numbers[0]) / abs(numbers[0]), 3)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list | tuple):
        return ", ".join(map(_cell, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _judged(interval: str) -> str:
    return f"{interval} if honest" if interval else ""


def _aligned(rows: Sequence[Sequence[str]], right: Sequence[int] | range) -> list[str]:
    """Return rows as lines with columns of equal width, those of ``right`` flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            f"{cell:>{width}}" if index in right else f"{cell:<{width}}"
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
