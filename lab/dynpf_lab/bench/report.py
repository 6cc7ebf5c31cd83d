"""The table of a benchmark for a person."""

from collections.abc import Iterable, Sequence
from typing import Any

from dynpf_lab.bench.measure import STAGES, exponent
from dynpf_lab.bench.peers import PEERS

__all__ = ["text"]

Row = dict[str, Any]


def text(rows: Sequence[Row]) -> str:
    """Return a table of milliseconds per update, with the ratios of the others (x)."""
    others = [name for name in ("numpy", *PEERS) if any(row[f"{name}_ms"] is not None for row in rows)]
    header = ["work", "n", "threads", "ours ms", "+-%"]
    for name in others:
        header += [f"{name} ms", "x"]
    header += ["used", "ns each", "B each", "B peak"]
    table = [header, *(_line(row, others) for row in rows)]
    parts = [_aligned(table)]
    staged = [row for row in rows if row["motion_ms"] is not None and row["threads"] == 1]
    if staged:
        lines = [[row["work"], str(row["n"]), *(_number(row[f"{stage}_ms"]) for stage in STAGES)] for row in staged]
        parts.append("the parts of our updates, ms\n" + _aligned([["work", "n", *STAGES], *lines]))
    parts.append("\n".join(_growth(rows)))
    return "\n\n".join(part for part in parts if part)


def _line(row: Row, others: Iterable[str]) -> list[str]:
    cells = [row["work"], str(row["n"]), str(row["threads"]), _number(row["ours_ms"])]
    cells.append(f"{row['ours_spread_percent']:.0f}")
    for name in others:
        cells += [_number(row[f"{name}_ms"]), _number(row[f"ratio_{name}"])]
    memory = (row["bytes_per_particle"], row["peak_bytes_per_particle"])
    return [
        *cells,
        str(row["n_used"]),
        _number(1e6 * row["ours_ms"] / row["n_used"]),
        *("" if b is None else f"{b:.0f}" for b in memory),
    ]


def _growth(rows: Sequence[Row]) -> Iterable[str]:
    for work, threads in dict.fromkeys((row["work"], row["threads"]) for row in rows):
        same = [row for row in rows if (row["work"], row["threads"]) == (work, threads)]
        counts = [row["n"] for row in same]
        power = exponent(counts, [row["ours_ms"] for row in same])
        if power is not None and work != "kld":
            ran = "1 thread" if threads == 1 else f"{threads} threads"
            yield f"{work}, {ran}: cost ~ N^{power:.2f} from {min(counts)} to {max(counts)}"


def _number(value: float | None) -> str:
    """Return three digits that count."""
    if value is None:
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _aligned(table: Sequence[Sequence[str]]) -> str:
    widths = [max(len(line[column]) for line in table) for column in range(len(table[0]))]
    lines = []
    for line in table:
        first, *others = (
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        lines.append("  ".join((first, *others)).rstrip())
    return "\n".join(lines)
