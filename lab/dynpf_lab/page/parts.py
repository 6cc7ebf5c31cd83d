"""The parts of a page that are words: heading, controls, tables. They are there without any script, too."""

from collections.abc import Iterable, Iterator, Sequence
from html import escape

from dynpf_experiments.pictures.estimates import Span
from dynpf_experiments.pictures.event import Event
from dynpf_experiments.pictures.figures import Figure
from dynpf_experiments.pictures.page import Apart, RunPicture

__all__ = ["body"]

SPEEDS = (0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100)
LAYERS = (
    ("truth", "truth", "true path"),
    ("estimate", "estimate", "estimate"),
    ("odometry", "odometry", "odometry alone"),
    ("particles", "dots particles", "particles"),
    ("readings", "dots readings", "readings"),
    ("ellipse", "ellipse", "3-sigma ellipse"),
    ("body", "body", "bodies"),
    ("map", "map", "map and landmarks"),
)
MOST_MARKS = 100


def body(runs: Sequence[RunPicture], apart: Apart | None) -> Iterator[str]:
    """Yield the lines of the body, but for the data and the scripts."""
    yield "<header>"
    yield f"<h1>{escape(_title(runs))}</h1>"
    yield from (_state(run) for run in runs)
    yield '<button id="theme" type="button">Light or dark</button>'
    yield "</header><main>"
    for index, run in enumerate(runs):
        yield from _facts(run, "AB"[index] if len(runs) > 1 else "")
    yield "<noscript><p>The pictures need JavaScript; the tables below do not.</p></noscript>"
    if apart is not None:
        yield from _apart(apart)
    yield from _stage(runs)
    yield '<h2>Over time</h2><div id="plots" class="plots"></div>'
    yield '<div class="tables">'
    for index, run in enumerate(runs):
        yield from _tables(run, f" of {'AB'[index]}" if len(runs) > 1 else "")
    yield "</div></main>"
    yield from _player(runs, apart)


def _title(runs: Sequence[RunPicture]) -> str:
    titles = list(dict.fromkeys(run.head.title for run in runs))
    return " against ".join(titles) + (" (two runs)" if len(runs) > len(titles) else "")


def _state(run: RunPicture) -> str:
    kind = "state" if run.head.complete else "state bad"
    return f'<span class="{kind}">{escape(run.head.state)}</span>'


def _facts(run: RunPicture, name: str) -> Iterator[str]:
    head = run.head
    missing = "" if head.missing is None else f", {head.missing} missing"
    ticks = f"{head.ticks} ticks" if head.ticks else "no ticks"
    facts = (
        head.file,
        f"seed {head.seed}",
        head.clock,
        f"{head.seconds:.1f} s",
        ticks,
        f"{head.messages} messages{missing}",
    )
    before = f"<b>{name}</b> · " if name else ""
    yield f'<p class="facts">{before}{escape(" · ".join(facts))}</p>'
    if head.lines:
        yield '<dl class="cards">'
        yield from (f"<div><dt>{escape(label)}</dt><dd>{escape(text)}</dd></div>" for label, text in head.lines)
        yield "</dl>"


def _apart(apart: Apart) -> Iterator[str]:
    yield "<section><h2>What sets the two runs apart</h2>"
    yield f"<p>First difference: <code>{escape(apart.first)}</code></p>"
    if apart.topics:
        rows = [(name, a, b, differ) for name, a, b, differ in apart.topics]
        yield from _folded("Messages that differ, by topic", ("topic", "A", "B", "differ"), rows)
    if apart.measures:
        yield from _folded("Measures that differ", ("measure", "A", "B"), apart.measures)
    yield "</section>"


def _stage(runs: Sequence[RunPicture]) -> Iterator[str]:
    yield '<div class="bar"><h2>The world, from above</h2>'
    yield '<button id="farther" type="button" aria-label="Farther">−</button>'
    yield '<button id="fit" type="button">Fit</button>'
    yield '<button id="closer" type="button" aria-label="Closer">+</button></div>'
    yield f'<div class="stage{" two" if len(runs) > 1 else ""}">'
    for index, run in enumerate(runs):
        yield '<section class="world">'
        if len(runs) > 1:
            yield f"<h3>{'AB'[index]}: {escape(run.head.file)}</h3>"
        text = f"The world of {run.head.file} from above; the table of poses says where the robot is."
        yield f'<canvas id="world-{index}" role="img" aria-label="{escape(text)}"></canvas>'
        if len(runs) > 1:
            yield from _readout(run, index)
        yield "</section>"
    yield '<div class="side">' if len(runs) == 1 else ""
    for index, run in enumerate(runs):
        yield from _cameras(run, index, " of " + "AB"[index] if len(runs) > 1 else "")
    if len(runs) == 1:
        yield from _readout(runs[0], 0)
    yield from _legend(runs)
    yield ("</div>" if len(runs) == 1 else "") + "</div>"


def _readout(run: RunPicture, index: int) -> Iterator[str]:
    unit = escape(run.data["unit"])
    heads = ("now", f"x ({unit})", f"y ({unit})", "heading (°)", f"off by ({unit})")
    cells = "".join(f'<th scope="col">{head}</th>' for head in heads)
    yield f'<div class="scroll" tabindex="0"><table class="readout"><thead><tr>{cells}</tr></thead>'
    yield f'<tbody id="readout-{index}"></tbody></table></div>'
    for number, each in enumerate(run.data["health"]):
        yield f'<p class="now-verdict">{escape(each["node"])} says: <b id="verdict-{index}-{number}"></b></p>'


def _cameras(run: RunPicture, index: int, of_run: str) -> Iterator[str]:
    for number, camera in enumerate(run.data["cameras"]):
        yield f'<figure class="camera" id="camera-{index}-{number}">'
        yield f'<svg viewBox="0 0 {camera["w"]} {camera["h"]}" role="img" aria-label="frame">'
        yield f'<image width="{camera["w"]}" height="{camera["h"]}"></image><g></g></svg>'
        yield f'<figcaption><b>{escape(camera["topic"])}{of_run}</b>, <span class="when"></span></figcaption></figure>'


def _legend(runs: Sequence[RunPicture]) -> Iterator[str]:
    data = [run.data for run in runs]
    there = {track["role"] for each in data for track in each["tracks"]} | {"map"}
    there |= {"particles"} if any(each["clouds"] for each in data) else set()
    there |= {"readings"} if any(each["readings"] for each in data) else set()
    there |= {"ellipse"} if any("cov" in track for each in data for track in each["tracks"]) else set()
    yield '<fieldset class="legend"><legend>Shown</legend>'
    for name, key, text in LAYERS:
        if name in there:
            box = f'<input type="checkbox" data-shows="{name}" checked>'
            yield f'<label>{box}<span class="key {key}"></span>{text}</label>'
    yield "</fieldset>"


def _player(runs: Sequence[RunPicture], apart: Apart | None) -> Iterator[str]:
    yield '<section class="player" aria-label="Player">'
    for index, run in enumerate(runs):
        for each in run.data["health"]:
            run_name = f"{'AB'[index]}: " if len(runs) > 1 else ""
            name = f"{run_name}{each['node']}: " if len(run.data["health"]) > 1 else run_name
            spans = "".join(_verdict(name, Span(*span)) for span in each["spans"])
            yield f'<div class="lane" aria-hidden="true">{spans}</div>'
    marks = [event for run in runs for event in run.events if event.kind != "end"][:MOST_MARKS]
    texts = [
        f'<span class="{escape(event.level)}" data-from="{event.seconds:.3f}" title="{escape(event.text)}"></span>'
        for event in marks
    ]
    if apart is not None and (at := _first_time(runs[0], apart)) is not None:
        texts.append(f'<span class="first" data-from="{at:.3f}" title="first difference"></span>')
    if texts:
        yield f'<div class="lane marks" aria-hidden="true">{"".join(texts)}</div>'
    yield '<input id="slider" type="range" min="0" max="1" value="0" step="1" aria-label="Time">'
    yield '<div class="controls"><button id="play" type="button">Play</button>'
    options = "".join(f'<option value="{speed}">{speed} ×</option>' for speed in SPEEDS)
    yield f'<label>Speed <select id="speed">{options}</select></label> <span id="time"></span>'
    yield "</div></section>"


def _verdict(name: str, span: Span) -> str:
    title = escape(f"{span.status}: {span.reason}" + (f"; {span.changed}" if span.changed else ""))
    kind = escape(span.status)
    times = f'data-from="{span.begin:.3f}" data-to="{span.end:.3f}"'
    return f'<span class="verdict {kind}" {times} title="{title}">{escape(name + _spoken(span.status))}</span>'


def _first_time(run: RunPicture, apart: Apart) -> float | None:
    """Return when the first difference is, by the first run's ticks."""
    if apart.tick is None:
        return None
    times, ticks = (_values(run.data["moments"][name]) for name in ("t", "tick"))
    return next((at for at, tick in zip(times, ticks, strict=True) if tick >= apart.tick), None)


def _values(packed: dict[str, object]) -> list[float]:
    """Return the numbers of a column."""
    quantum, found, steps = packed["q"], [], 0
    assert isinstance(quantum, float)
    differences = packed["d"]
    assert isinstance(differences, list)
    for difference in differences:
        steps += difference or 0
        found.append(steps * quantum)
    return found


def _tables(run: RunPicture, of_run: str) -> Iterator[str]:
    yield f"<section><h2>Measures{of_run}</h2>"
    for name, rows in run.figures.items():
        yield from _figures(rows, name)
    yield f"</section><section><h2>Health{of_run}</h2>"
    yield from _health(run)
    yield f"</section><section><h2>What happened{of_run}</h2>"
    yield from _events(run)
    yield f"</section><section><h2>The same again{of_run}</h2>"
    yield from _provenance(run)
    yield "</section>"


def _figures(rows: Sequence[Figure], name: str) -> Iterator[str]:
    if name:
        yield f"<h3>{escape(name)}</h3>"
    if not rows:
        yield '<p class="quiet">Nothing to measure: the recording has no truth, or no estimates.</p>'
        return
    cells = [(row.label, row.value, row.unit, row.interval) for row in rows]
    heads = ("measure", "value", "unit", "95 % of honest filters")
    yield from _table(heads if any(row.interval for row in rows) else heads[:3], cells)


def _health(run: RunPicture) -> Iterator[str]:
    spans = [(node, *span) for node, of_node in run.health.items() for span in of_node]
    if not spans:
        yield '<p class="quiet">No node says how reliable its estimate is.</p>'
        return
    rows = [
        (_Seek(begin), f"{end - begin:.1f} s", node, _spoken(status), reason, changed)
        for node, begin, end, status, reason, changed in spans
    ]
    heads = ("from", "for", "node", "verdict", "reason", "what changed")
    if len(rows) <= 8:
        yield from _table(heads, rows)
    else:
        yield from _folded(f"{len(rows)} verdicts, with their reasons", heads, rows)


def _events(run: RunPicture) -> Iterator[str]:
    if run.faults:
        yield "<p>Faults of the network that the scenario injects:</p><ul>"
        yield from (f"<li>{escape(text)}</li>" for text in run.faults)
        yield "</ul>"
    rows = [(_Seek(event.seconds), _named(event), event.node, event.text) for event in run.events]
    heads = ("at", "what", "node", "")
    if len(rows) <= 12:
        yield from _table(heads, rows)
    else:
        yield from _folded(f"{len(rows)} of {run.events_in_all} events", heads, rows)


def _provenance(run: RunPicture) -> Iterator[str]:
    head = run.head
    yield f'<p class="command"><code>{escape(head.replay)}</code> <button class="copy" type="button">Copy</button>'
    yield '<span role="status"></span></p>'
    yield f"<p>Content digest <code>{escape(head.digest)}</code></p>"
    yield from _folded("Versions", ("what", "version"), head.versions)
    if run.notes:
        yield "<details><summary>What this page leaves out</summary><p>The recording has it all.</p><ul>"
        yield from (f"<li>{escape(note)}</li>" for note in run.notes)
        yield "</ul></details>"


class _Seek(float):
    """A time in a table, which shows that moment when it is pressed."""

    def html(self) -> str:
        """Return the button."""
        return f'<button class="seek" type="button" data-seek="{float(self):.3f}">{float(self):.2f} s</button>'


def _named(event: Event) -> str:
    return event.kind if event.level == "info" else f"{event.kind}, {event.level}"


def _spoken(status: str) -> str:
    return status.replace("_", " ")


def _folded(summary: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    yield f"<details><summary>{escape(summary)}</summary>"
    yield from _table(heads, rows)
    yield "</details>"


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Yield a table; its cells are texts, numbers, or times to be shown."""
    yield '<div class="scroll" tabindex="0"><table><thead><tr>'
    yield "".join(f'<th scope="col">{escape(head)}</th>' if head else "<td></td>" for head in heads)
    yield "</tr></thead><tbody>"
    for row in rows:
        cells = [each.html() if isinstance(each, _Seek) else escape(str(each)) for each in row[: len(heads)]]
        yield f'<tr><th scope="row">{cells[0]}</th>' + "".join(f"<td>{cell}</td>" for cell in cells[1:]) + "</tr>"
    yield "</tbody></table></div>"
