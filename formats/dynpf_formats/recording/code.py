"""What code a recording names: read from its scenario's text alone, whether or not that could be run."""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from dynpf_formats.recording.reader import Recording
from dynpf_formats.user_classes import CLASS_NAME, UserClass, is_standard

__all__ = ["code_in_words", "described_code", "recorded_code"]


def recorded_code(recording: Recording) -> tuple[UserClass, ...]:
    """Return the classes that a replay would import and run, if it were allowed to; none of them is looked for."""
    try:
        scenario = json.loads(recording.header.scenario)
    except (ValueError, RecursionError):
        return ()  # of such a scenario nothing can be run
    return tuple(_named("", scenario))


def _named(key: str, value: Any) -> Iterator[UserClass]:
    """Yield what a value of a scenario names, and all that lies below it; a kind may stand there alone."""
    if isinstance(value, str) and CLASS_NAME.fullmatch(value):
        module, _, name = value.partition(":")
        yield UserClass(key if key.endswith("kind") else f"{key}.kind", module, name)
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _named(f"{key}.{name}".removeprefix("."), inner)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            named = inner.get("name") if key == "nodes" and isinstance(inner, dict) else None
            yield from _named(f"{key}.{place if named is None else named}", inner)


def described_code(named: Iterable[UserClass]) -> list[dict[str, str]]:
    """Return what a replay would import and run, as ``info`` and ``doctor`` print it with --json."""
    return [{"key": one.key, "module": one.module, "class": one.name} for one in named]


def code_in_words(code: Iterable[dict[str, str]]) -> list[str]:
    """Return what a replay would import and run as lines for a person."""
    lines = []
    for one in code:
        module = one["module"]
        allowed = "replay refuses" if is_standard(module) else f"replay runs only with --allow-code {module}"
        lines.append(f"code: {one['key']} names the class {one['class']} of the module {module}, which {allowed}")
    return lines
