"""The HTML of a page. All that comes from a recording is escaped: it is text, and never becomes markup or code."""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from pathlib import Path

from dynpf_experiments import pictures
from dynpf_experiments.pictures.page import Apart, RunPicture
from dynpf_formats.shipped import systems

from dynpf_lab.page import parts
from dynpf_lab.page.bundle import bundled

__all__ = ["FOLDER", "document", "hash_of", "made_by", "modules", "plotting", "style_of"]

FOLDER = Path(__file__).parent
"""Where style sheets, modules and what comes along lie."""


def document(runs: Sequence[RunPicture], apart: Apart | None, mark: str) -> str:
    """Return the page of one run, or of two and what sets them ``apart``; ``mark`` is a comment in its first lines."""
    style, scripts = style_of(), _scripts()
    title = " against ".join(run.head.file for run in runs)
    policy = "; ".join(
        (
            "default-src 'none'",
            "img-src data:",
            f"style-src {hash_of(style)}",
            f"script-src {' '.join(map(hash_of, scripts))}",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    return "\n".join(
        (
            "<!doctype html>",
            f"<!-- {mark} -->",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>{escape(title)}</title>",
            f"<style>{style}</style>",
            "</head>",
            "<body>",
            *parts.body(runs, apart),
            f'<script type="application/json" id="data">{_data(runs)}</script>',
            f"<script>{scripts[0]}</script>",
            f'<script type="module">{scripts[1]}</script>',
            "</body>",
            "</html>",
            "",
        )
    )


@cache
def made_by() -> str:
    """Return a digest of all that makes pages besides the recording, so that an old page is made anew."""
    digest = hashlib.sha256()
    for text in (style_of(), *_scripts(), *(file.read_text("utf-8") for file in _sources())):
        digest.update(hashlib.sha256(text.encode()).digest())
    return digest.hexdigest()[:16]


def _sources() -> Iterable[Path]:
    """Return the modules that decide what is on a page."""
    folders = [FOLDER, *map(Path, pictures.__path__)]
    own = [Path(system.__path__[0]) / "pictures.py" for system in systems()]
    return sorted(file for folder in folders for file in folder.glob("*.py")) + [file for file in own if file.is_file()]


def _data(runs: Sequence[RunPicture]) -> str:
    """Return the data as JSON in which nothing can end a script; raises ValueError for a number that is not finite."""
    data = {"runs": [run.data for run in runs]}
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def style_of(*others: str) -> str:
    """Return the style of pages, and ``others`` beside it."""
    return "\n".join((FOLDER / name).read_text("utf-8") for name in ("vendor/uPlot.min.css", "page.css", *others))


@cache
def plotting() -> str:
    """Return the script that draws plots."""
    return (FOLDER / "vendor/uPlot.iife.min.js").read_text("utf-8").strip()


@cache
def modules() -> dict[str, str]:
    """Return the modules of the pages' scripts by their names."""
    return {file.stem: file.read_text("utf-8") for file in sorted((FOLDER / "js").glob("*.mjs"))}


@cache
def _scripts() -> tuple[str, str]:
    return plotting(), bundled(modules(), "main")


def hash_of(text: str) -> str:
    """Return a text's digest as a policy names it."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"
