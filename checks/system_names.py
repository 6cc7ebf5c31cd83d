"""Finds systems named in generic code: `python -m checks.system_names` prints each finding and exits 1 if there is one.

A system is one folder and one line: what drives, records, measures and studies nodes knows none. So no generic file has
a word that only one system means, neither in a name nor in a text. PARTS is called by plain words: those count where
they are an attribute or an argument, the beginning of a longer name, a topic, a module or a scenario.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["findings"]

GENERIC = (
    "experiments/dynpf_experiments",
    "formats/dynpf_formats",
    "lab/dynpf_lab",
    "protocol/dynpf_protocol",
    "runtime/dynpf_runtime",
    "services/dynpf_services",
)

WORDS = ("capsule", "colon", "rearrangement", "tube", "workspace")
PARTS = (
    r"\bPARTS\b",
    r"\bParts?[A-Z]",  # a type
    r"\bparts?_\w",  # part_radius
    r"[./]parts\b",  # an attribute, a module, a topic
    r"\bparts(?=\s*=[^=])",  # an argument
    r"\bparts-\d",  # a scenario
)

_WORD = re.compile(rf"(?<![A-Za-z])({'|'.join(WORDS)})s?(?![a-z])", re.IGNORECASE)
_PARTS = re.compile("|".join(PARTS))
_LOCAL = re.compile(r"^\s*parts = ")  # a variable: plain English
_IN_CAPITALS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


def findings(source: str, file: str) -> list[str]:
    """Return one line for each word of a system in a file's source, named relative to the repository."""
    return [f"{file}:{line}: {word} is a system's" for line, word in _words(source)]


def _words(source: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(source.splitlines(), start=1):
        yield from ((number, found[0]) for found in _WORD.finditer(_IN_CAPITALS.sub("_", line)))
        yield from ((number, found[0]) for found in _PARTS.finditer(_LOCAL.sub("", line)))


def main() -> int:
    root = Path(__file__).parents[1]
    paths = sorted(path for name in GENERIC for kind in ("*.py", "*.toml") for path in (root / name).rglob(kind))
    found = [line for path in paths for line in findings(path.read_text(), path.relative_to(root).as_posix())]
    print(
        "\n".join(found) or f"Names of systems: {len(paths)} generic files, none in them.",
        file=sys.stderr if found else sys.stdout,
    )
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
