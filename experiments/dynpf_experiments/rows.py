"""Summaries of trials: rows of factors and measures, as JSON, CSV and a text table."""

import csv
import io
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dynpf.metrics.seeds import mean, proportion, spread

__all__ = ["Row", "Sample", "as_csv", "as_table", "columns_of", "measured", "summarized"]

Row = dict[str, Any]


class Sample(NamedTuple):
    """The measures of a trial and its ``factors``. A bool counts as a share of the trials; NaN is left out."""

    factors: dict[str, Any]
    measures: dict[str, float | bool]


def summarized(samples: Iterable[Sample], pooled: str | None = None) -> list[Row]:
    """Return a row for each combination of factors, in order; then rows pooled over all values of factor ``pooled``."""
    groups: dict[tuple[tuple[str, Any], ...], list[Sample]] = {}
    for sample in samples:
        for factors in (sample.factors, *([sample.factors | {pooled: "all"}] if pooled else [])):
            groups.setdefault(tuple(factors.items()), []).append(sample)
    rows = [_row(dict(factors), group) for factors, group in groups.items()]
    if pooled is None:
        return rows
    return [row for row in rows if row[pooled] != "all"] + [row for row in rows if row[pooled] == "all"]


def _row(factors: dict[str, Any], samples: Sequence[Sample]) -> Row:
    row: Row = {**factors, "trials": len(samples)}
    for name in samples[0].measures:
        values = [sample.measures[name] for sample in samples]
        known = [value for value in values if not math.isnan(value)]
        if not known:
            continue
        if isinstance(values[0], bool):
            share = proportion(sum(map(bool, known)), len(known))
            row |= {
                name: 100.0 * share.rate,
                f"{name}_ci_low": 100.0 * share.low,
                f"{name}_ci_high": 100.0 * share.high,
            }
            continue
        numbers = np.array(known, dtype=np.float64)
        about, sorted_out = mean(numbers), spread(numbers)
        row |= {
            f"{name}_mean": about.mean,
            f"{name}_median": sorted_out.median,
            f"{name}_p95": sorted_out.p95,
            f"{name}_ci_low": about.low if math.isfinite(about.low) else None,
            f"{name}_ci_high": about.high if math.isfinite(about.high) else None,
        }
    return row


def measured(rows: Sequence[Row]) -> dict[str, str]:
    """Return the names of the rows' measures, each with the key of its mean or, in percent, of its share."""
    names = dict.fromkeys(key.removesuffix("_ci_low") for row in rows for key in row if key.endswith("_ci_low"))
    shares = {name for name in names if any(name in row for row in rows)}
    return {name: name if name in shares else f"{name}_mean" for name in names}


def columns_of(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """Return all columns for ``as_table``: the factors, and each measure with its interval."""
    factors = dict.fromkeys(key for row in rows for key in itertools.takewhile(lambda key: key != "trials", row))
    columns = [(name, "", name) for name in (*factors, "trials")]
    for name, centre in measured(rows).items():
        heading = f"{name} % (95 %)" if centre == name else f"{name} (95 %)"
        columns.append((heading, ".4g", f"{centre} {name}_ci_low {name}_ci_high"))
    return columns


def as_csv(rows: Sequence[Row]) -> str:
    """Return rows as CSV, with a column for each key of any row."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_table(rows: Sequence[Row], columns: Sequence[tuple[str, str, str]]) -> str:
    """Return rows as a text table; ``columns`` are heading, format spec, and the keys shown, joined by " / "."""
    lines = [[heading for heading, _, _ in columns]]
    lines += [[_cell(row, spec, keys) for _, spec, keys in columns] for row in rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def _cell(row: Row, spec: str, keys: str) -> str:
    values = [row.get(key) for key in keys.split()]
    if all(value is None for value in values):
        return ""
    return " / ".join("-" if value is None else format(value, spec) for value in values)
