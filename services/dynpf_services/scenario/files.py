"""The files that a scenario names: read once, known by their bare names and digests, and carried by recordings."""

import hashlib
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import Any

import msgspec
from dynpf_protocol.errors import ScenarioError

from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import fact_kind, fact_names
from dynpf_services.scenario.schema import File, Scenario

__all__ = ["seen_from_here", "with_files"]


def with_files(scenario: Scenario, where: str, read: Callable[[str, str], bytes]) -> Scenario:
    """Return the scenario with the files that it names in it.

    ``read`` gives a file by its path; it is told, too, which of ``scenario.paths`` led to it, for a map names its
    image. In the result files go by their bare names, so that the same files in another folder make the same scenario;
    by its bare name, a file is taken from the scenario if that holds it.
    Raises ScenarioError for a file that cannot be read or is no map.
    """
    held = {name: file.data for name, file in scenario.files.items() if file.data}
    found: dict[str, bytes] = {}

    def take(named: str, name: str) -> bytes:
        folder, bare = PurePath(named).parent, PurePath(name).name
        data = held[bare] if bare in held and folder == PurePath() else read(str(folder / name), named)
        if found.setdefault(bare, data) != data:
            raise ValueError(f"two files are called {bare}")
        return data

    facts = {key: _taken(key, value, where, take) for key, value in scenario.facts.items()}
    files = {name: File(sha256=hashlib.sha256(data).hexdigest(), data=data) for name, data in found.items()}
    scenario = msgspec.structs.replace(scenario, facts=facts, files=files)
    for key in facts:
        try:
            fact_kind(key).check(Context(scenario, ""))
        except ScenarioError as error:
            raise ScenarioError(f"{where}: {error}") from error
    return scenario


def _taken(key: str, value: Any, where: str, take: Callable[[str, str], bytes]) -> Any:
    """Return a shared table whose files have been taken, with their bare names."""
    kind = fact_kind(key)
    for path in kind.files(value):
        named = f"{where}: {key}{kind.key}"
        try:
            kind.take(path, value, take)
        except OSError as error:
            raise ScenarioError(f"{named}: {path!r} cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise ScenarioError(f"{named}: {error}") from error
    return kind.bare(value)


def seen_from_here(raw: dict[str, Any], override: str) -> None:
    """Make the paths in a list of files that an override gives absolute: they are seen from the current folder."""
    key = override.partition("=")[0]
    name = key.partition(".")[0]
    paths = raw.get(name)
    if name in fact_names() and fact_kind(name).listed and isinstance(paths, list):
        which = range(len(paths)) if key == name else [int(key.removeprefix(f"{name}."))]
        for place in which:
            if isinstance(paths[place], str):
                paths[place] = str(Path(paths[place]).absolute())
