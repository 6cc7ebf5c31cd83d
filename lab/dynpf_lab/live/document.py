"""The HTML of a live page. All that comes from a run is escaped here, or is set as text by the page's script."""

from collections.abc import Iterator, Sequence
from functools import cache
from html import escape

from dynpf_lab.page import parts
from dynpf_lab.page.bundle import bundled
from dynpf_lab.page.document import hash_of, modules, plotting, style_of

__all__ = ["live_document"]

SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10", "20", "50", "100")


def live_document(title: str, facts: Sequence[str], *, may_act: bool) -> tuple[str, str]:
    """Return the page of a run that goes on, and the policy that its server sends along."""
    style, script = style_of("live.css"), _script()
    policy = "; ".join(
        (
            "default-src 'none'",
            "img-src data:",
            f"style-src {hash_of(style)}",
            f"script-src {hash_of(plotting())} {hash_of(script)}",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )
    lines = (
        "<!doctype html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>{escape(title)}, live</title>",
        f"<style>{style}</style>",
        "</head>",
        "<body>",
        *_body(title, facts, may_act=may_act),
        f"<script>{plotting()}</script>",
        f'<script type="module">{script}</script>',
        "</body>",
        "</html>",
        "",
    )
    return "\n".join(lines), policy


@cache
def _script() -> str:
    return bundled(modules(), "live")


def _body(title: str, facts: Sequence[str], *, may_act: bool) -> Iterator[str]:
    yield "<header>"
    yield f"<h1>{escape(title)}</h1>"
    yield '<span id="state" class="state" role="status">waiting for the run</span>'
    yield '<button id="theme" type="button">Light or dark</button>'
    yield "</header><main>"
    yield f'<p class="facts">{escape(" · ".join(facts))}</p>'
    yield '<section id="over" hidden><p id="reason"></p>'
    yield '<p id="page-waits">Its page is being made.</p>'
    yield '<p id="page-link" hidden><a href="run.html">The page of the whole run</a></p></section>'
    yield "<noscript><p>A live page needs JavaScript.</p></noscript>"
    yield from _stage()
    yield from _hand(may_act=may_act)
    yield '<h2>Over time</h2><div id="plots" class="plots"></div>'
    yield '<section><h2>What happens</h2><ul id="said" tabindex="0" aria-label="What happens"></ul></section>'
    yield "</main>"
    yield from _player()


def _stage() -> Iterator[str]:
    yield '<div class="bar"><h2>The world, from above</h2>'
    yield '<button id="farther" type="button" aria-label="Farther">−</button>'
    yield '<button id="fit" type="button">Fit</button>'
    yield '<button id="closer" type="button" aria-label="Closer">+</button></div>'
    yield '<div class="stage"><section class="world">'
    text = "The world of the run from above; the table of poses says where the robot is."
    yield f'<canvas id="world-0" role="img" aria-label="{text}"></canvas></section>'
    yield '<div class="side"><div id="cameras"></div>'
    heads = ("now", "x", "y", "heading (°)", "off by")
    cells = "".join(f'<th scope="col">{head}</th>' for head in heads)
    yield f'<div class="scroll" tabindex="0"><table class="readout"><thead><tr>{cells}</tr></thead>'
    yield '<tbody id="readout-0"></tbody></table></div><div id="verdicts"></div>'
    yield '<fieldset class="legend"><legend>Shown</legend>'
    for name, key, words in parts.LAYERS:
        box = f'<input type="checkbox" data-shows="{name}" checked>'
        yield f'<label>{box}<span class="key {key}"></span>{words}</label>'
    yield "</fieldset></div></div>"


def _hand(*, may_act: bool) -> Iterator[str]:
    """Yield what a person does to the world; parts for which the run has no acts stay hidden."""
    yield f'<section data-act="drive move place body door map"{"" if may_act else " hidden"}><h2>By hand</h2>'
    yield '<p class="quiet">Drag the robot, or a body, to put it elsewhere; the wheel turns what is dragged.</p>'
    yield '<div id="hand">'
    yield '<div class="drive" data-act="drive move">'
    yield '<label><input id="drives" type="checkbox"> Drive by arrow keys or W A S D, Q and E</label>'
    yield _number("drive-speed", "at (m/s)", 0.3, 0.05) + _number("drive-turn", "and (rad/s)", 1.0, 0.1) + "</div>"
    yield '<form id="place" data-act="place">'
    yield _number("place-x", "x", 0.0) + _number("place-y", "y", 0.0) + _number("place-h", "heading (°)", 0.0, 1.0)
    yield '<button type="submit">Put the robot there</button></form>'
    yield '<form id="body" data-act="body"><label>body <select id="body-number"></select></label>'
    yield _number("body-x", "x", 0.0) + _number("body-y", "y", 0.0)
    yield '<button type="submit">Put it there</button></form>'
    yield '<form id="door" data-act="door">' + _number("door-number", "door", 1, 1)
    yield '<button value="closed">close</button><button value="open">open</button>'
    yield '<button value="scheduled">as planned</button></form>'
    yield '<form id="map" data-act="map"><label>map <input id="map-name" type="text" maxlength="64" size="8"></label>'
    yield '<button type="submit">holds</button></form>'
    yield '</div><output id="status" role="status"></output></section>'


def _number(name: str, label: str, value: float, step: float = 0.01) -> str:
    return f'<label>{label} <input id="{name}" type="number" value="{value:g}" step="{step:g}" required></label>'


def _player() -> Iterator[str]:
    yield '<section class="player" aria-label="Player">'
    yield '<input id="slider" type="range" min="0" max="0" value="0" step="1" aria-label="Time">'
    yield '<div class="controls"><button id="pause" type="button" data-paces>Pause</button>'
    yield '<button id="step" type="button" data-paces>Step</button>'
    options = "".join(f'<option value="{speed}">{speed} ×</option>' for speed in SPEEDS)
    options += '<option value="0">as fast as it goes</option>'
    yield f'<label>Speed <select id="speed" data-paces>{options}</select></label>'
    yield '<button id="now" type="button" hidden>Back to now</button> <span id="time"></span>'
    yield "</div></section>"
