"""A line of progress on a terminal."""

import sys

__all__ = ["show_progress"]


def show_progress(text: str) -> None:
    """Replace the line of progress by ``text``, or remove it if that is empty; only where stderr is a terminal."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
