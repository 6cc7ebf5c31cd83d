"""The page of a study or a sweep: its rows as a table, each measure with its intervals, and its figures; no script.

All text is escaped, and nothing but the page itself is needed to look at it.
"""

import base64
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from dynpf_experiments.rows import Row, columns_of, measured

__all__ = ["Told", "study_page"]

FOLDER = Path(__file__).parent
KINDS = {".png": "image/png", ".svg": "image/svg+xml"}
MOST_ROWS = 60
"""Rows of a chart; the table has all."""

_ROW, _LEFT, _WIDTH, _RIGHT = 22.0, 300.0, 420.0, 90.0


class Told(NamedTuple):
    """What a study is: its name, what it asks, how it was called, and the settings of a run of it."""

    name: str
    about: str
    command: str
    settings: dict[str, Any]
    trials: int
    seed: int


def study_page(told: Told, rows: Sequence[Row], figures: Sequence[Path]) -> str:
    """Return the page; figures of other kinds than PNG and SVG are left out."""
    style = "\n".join((FOLDER / name).read_text("utf-8") for name in ("page.css", "study.css"))
    return "\n".join(
        (
            "<!doctype html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
            "style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'\">",
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>{escape(told.name)}</title>",
            f"<style>{style}</style>",
            "</head>",
            '<body class="study">',
            f"<header><h1>{escape(told.name)}</h1></header><main>",
            f"<p>{escape(told.about)}</p>",
            f"<p>{told.trials} trials each, seed {told.seed}. <code>{escape(told.command)}</code></p>",
            *_charts(rows),
            *_table(rows),
            *_figures(figures),
            *_settings(told.settings),
            "</main></body>",
            "</html>",
            "",
        )
    )


def _charts(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a chart for each measure: a dot for each row, with its 95 % interval."""
    names = _factors(rows)
    for name, centre in measured(rows).items():
        shown = [row for row in rows if row.get(centre) is not None][:MOST_ROWS]
        spans = [
            (_or(row.get(f"{name}_ci_low"), row[centre]), _or(row.get(f"{name}_ci_high"), row[centre])) for row in shown
        ]
        low, high = min((span[0] for span in spans), default=0.0), max((span[1] for span in spans), default=0.0)
        unit = " (%)" if centre == name else ""
        yield f"<h2>{escape(_words(name))}{unit}</h2>"
        height = _ROW * len(shown) + 26.0
        label = f"{_words(name)}: value and 95 % interval of each row; the table below has the numbers"
        yield (
            f'<div class="wide"><svg viewBox="0 0 {_LEFT + _WIDTH + _RIGHT:.0f} {height:.0f}" role="img" '
            f'aria-label="{escape(label)}">'
        )
        for index, (row, span) in enumerate(zip(shown, spans, strict=True)):
            yield from _dot(_named(row, names), row[centre], span, (low, high), (index + 0.5) * _ROW)
        foot = height - 8.0
        yield f'<text x="{_LEFT}" y="{foot}">{low:.4g}</text>'
        yield f'<text x="{_LEFT + _WIDTH}" y="{foot}" text-anchor="end">{high:.4g}</text></svg></div>'


def _dot(text: str, value: float, span: tuple[float, float], limits: tuple[float, float], y: float) -> Iterator[str]:
    def place(number: float) -> float:
        low, high = limits
        return _LEFT + _WIDTH * ((number - low) / (high - low) if high > low else 0.5)

    yield f'<text x="{_LEFT - 12}" y="{y + 4}" text-anchor="end">{escape(text)}</text>'
    yield f'<line class="axis" x1="{_LEFT}" x2="{_LEFT + _WIDTH}" y1="{y}" y2="{y}"/>'
    yield f'<line class="span" x1="{place(span[0]):.1f}" x2="{place(span[1]):.1f}" y1="{y}" y2="{y}"/>'
    yield f'<circle cx="{place(value):.1f}" cy="{y}" r="4.5"/>'
    yield f'<text x="{_LEFT + _WIDTH + 12}" y="{y + 4}">{value:.4g}</text>'


def _table(rows: Sequence[Row]) -> Iterator[str]:
    columns = columns_of(rows)
    yield '<h2>All rows</h2><div class="wide" tabindex="0" role="region" aria-label="All rows"><table><thead><tr>'
    yield "".join(f'<th scope="col">{escape(_words(heading))}</th>' for heading, _, _ in columns)
    yield "</tr></thead><tbody>"
    for row in rows:
        yield f"<tr>{''.join(f'<td>{escape(_cell(row, spec, keys))}</td>' for _, spec, keys in columns)}</tr>"
    yield "</tbody></table></div>"


def _figures(figures: Sequence[Path]) -> Iterator[str]:
    shown = [path for path in figures if path.suffix in KINDS]
    if shown:
        yield "<h2>Figures</h2>"
    for path in shown:
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        name = _words(path.stem.replace("-", "_"))
        yield f'<figure><img alt="{escape(name)}" src="data:{KINDS[path.suffix]};base64,{data}">'
        yield f"<figcaption>{escape(name)}</figcaption></figure>"


def _settings(settings: dict[str, Any]) -> Iterator[str]:
    if settings:
        yield "<h2>Settings</h2><table><tbody>"
        yield from (
            f'<tr><th scope="row">{escape(name)}</th><td>{escape(str(value))}</td></tr>'
            for name, value in settings.items()
        )
        yield "</tbody></table>"


def _factors(rows: Sequence[Row]) -> list[str]:
    """Return the factors that not all rows have alike."""
    names = dict.fromkeys(key for row in rows for key in [*row][: [*row].index("trials")])
    return [name for name in names if len({str(row.get(name)) for row in rows}) > 1]


def _named(row: Row, names: Sequence[str]) -> str:
    return ", ".join(f"{name} {row[name]}" for name in names if row.get(name) not in (None, "")) or "all"


def _cell(row: Row, spec: str, keys: str) -> str:
    values = [row.get(key) for key in keys.split()]
    if len(values) == 3 and values[0] is not None:
        low, high = ("-" if value is None else format(value, spec) for value in values[1:])
        return f"{format(values[0], spec)} ({low} to {high})"
    return "" if values[0] is None else format(values[0], spec)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _or(value: float | None, other: float) -> float:
    return other if value is None else value
