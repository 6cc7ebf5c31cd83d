"""Text from elsewhere, made fit for a terminal and a line of a log: no control characters, and not too long."""

__all__ = ["MOST_CHARACTERS", "printable"]

MOST_CHARACTERS = 500
"""The length of a text that ``printable`` returns, at most."""


def printable(text: str, most: int = MOST_CHARACTERS) -> str:
    """Return ``text`` with what would control a terminal or break the line written as an escape, such as ``\\x1b``.

    Of a text longer than ``most`` characters the end is left out, and its length said.
    """
    shown = text[:most]
    if not shown.isprintable():  # control characters, right-to-left marks, surrogates, separators of lines
        shown = "".join(char if char.isprintable() else _escaped(char) for char in shown)
    return shown if len(text) <= most else f"{shown[:most]}... ({len(text)} characters)"


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")
