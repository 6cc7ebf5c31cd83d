"""Writes the figures of README.md anew: `python -m docs.readme`; the tests hold the page to them.

They are what the page's own commands print. The run is made in one process, which gives the same bytes as the bus.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

__all__ = ["README", "printed_by_make_run", "with_figures"]

README = Path(__file__).parents[1] / "README.md"
_PRINTED = re.compile(r"(tells what happened:\n\n```\n).*?(```\n)", flags=re.DOTALL)


def printed_by_make_run() -> str:
    """Return what `make run` prints of its run; the names of its files have a date, which is left out."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        command = [
            sys.executable,
            "-m",
            "dynpf_lab.cli.main",
            "run",
            "parts-3-easy",
            "--runner",
            "inline",
            "-o",
            str(path),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        shown = done.stdout.replace(str(path), "runs/parts-3-easy-1-....mcap")
        return shown.replace(str(path.with_suffix(".html")), "runs/parts-3-easy-1-....html")


def with_figures(page: str, printed: str) -> str:
    """Return the page with what `make run` prints in its place; raises ValueError if there is no such place."""
    found, count = _PRINTED.subn(lambda place: place[1] + printed + place[2], page)
    if count != 1:
        raise ValueError(f"README.md has {count} places for what `make run` prints; expected one")
    return found


if __name__ == "__main__":
    README.write_text(with_figures(README.read_text(), printed_by_make_run()))
