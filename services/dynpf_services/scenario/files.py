"""The files that a scenario names: read once, identified by bare name and digest, and attached to recordings."""

import hashlib
from collections.abc import Callable
from os.path import expanduser
from pathlib import Path, PurePath
from typing import Any

import msgspec
from dynpf_protocol.errors import ScenarioError

from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import fact_kind, fact_names
from dynpf_services.scenario.schema import File, Scenario

__all__ = ["make_paths_absolute", "with_files"]


def with_files(scenario: Scenario, where: str, read: Callable[[str, str], bytes]) -> Scenario:
    """Return the scenario with the content of the files that it names.

    ``read`` returns a file by its path; its second argument is the entry of ``scenario.paths`` that led to it, because
    a map names its image. The result has files by their bare names, so that the same files in another folder make the
    same scenario. A bare name refers to a file that the scenario already holds, if there is one.
    Raises ScenarioError for a file that cannot be read or is no map.
    """
    held = {name: file.data for name, file in scenario.files.items() if file.data}
    found: dict[str, bytes] = {}

    def take(named: str, name: str) -> bytes:
        folder, bare = PurePath(named).parent, PurePath(name).name
        path = folder / expanduser(name)  # noqa: PTH111 - never raises
        data = held[bare] if bare in held and folder == PurePath() else read(str(path), named)
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
    """Take the files of a shared table, and return it with their bare names."""
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


def make_paths_absolute(raw: dict[str, Any], override: str) -> None:
    """Make the paths that an override sets in a list of files absolute: they are relative to the current folder."""
    key = override.partition("=")[0]
    name = key.partition(".")[0]
    paths = raw.get(name)
    if name in fact_names() and fact_kind(name).listed and isinstance(paths, list):
        which = range(len(paths)) if key == name else [int(key.removeprefix(f"{name}."))]
        for index in which:
            if isinstance(paths[index], str):
                paths[index] = str(Path(paths[index]).absolute())
