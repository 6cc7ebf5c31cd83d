"""The systems that come with dynpf, found by name in the list of the package ``dynpf_systems``, and their topics.

This module knows no system, and never imports what a recording or a scenario names.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

from dynpf_protocol.topics import TOPICS, Topic

__all__ = ["known_topics", "load", "systems"]

SYSTEMS = "dynpf_systems"
"""The package of the systems: its SYSTEMS lists the subpackages, each of which names its parts by import strings."""


@cache
def systems() -> tuple[Any, ...]:
    """Return the packages of the systems."""
    return tuple(import_module(f"{SYSTEMS}.{name}") for name in import_module(SYSTEMS).SYSTEMS)


def load(text: str) -> Any:
    """Return the object that an import string of dynpf's own code names: ``package.module:name``."""
    module, _, name = text.partition(":")
    return getattr(import_module(module), name)


@cache
def known_topics() -> Mapping[str, Topic]:
    """Return the topics of all nodes that come with dynpf, as nodes with their usual names have them.

    Topics of any robot come first, then those of each system.
    """
    own = [row for system in systems() if hasattr(system, "TOPICS") for row in load(system.TOPICS)]
    return {**TOPICS, **{row.name: row for row in own}}
