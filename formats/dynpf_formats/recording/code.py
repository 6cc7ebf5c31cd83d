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
    estimator = scenario.get("estimator") if isinstance(scenario, dict) else None
    tables = estimator.items() if isinstance(estimator, dict) else ()
    return tuple(one for field, table in tables for one in _named(f"estimator.{field}", table))


def _named(key: str, table: Any) -> Iterator[UserClass]:
    """Yield what one component's table names, or each of a list of them; a kind may stand there alone."""
    listed = [(f"{key}.{place}", one) for place, one in enumerate(table)] if isinstance(table, list) else [(key, table)]
    for where, one in listed:
        kind = one.get("kind") if isinstance(one, dict) else one
        if isinstance(kind, str) and CLASS_NAME.fullmatch(kind):
            module, _, name = kind.partition(":")
            yield UserClass(f"{where}.kind", module, name)


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
