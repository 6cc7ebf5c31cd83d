"""Which studies the systems bring; a study is loaded only when it is asked for."""

from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.kinds import load, systems

if TYPE_CHECKING:
    from dynpf_experiments.study import Study

__all__ = ["study_named", "study_names"]


def study_names() -> list[str]:
    """Return the names of the studies in the order of the alphabet."""
    return sorted(_listed())


def study_named(name: str) -> "Study":
    """Return a study by its name; raises UsageError, which names those that there are."""
    listed = _listed()
    if name not in listed:
        raise UsageError(f"unknown study {name!r}; expected one of {', '.join(study_names())}")
    found: Study = load(listed[name])
    return found


def _listed() -> dict[str, str]:
    return {name: text for system in systems() for name, text in system.STUDIES.items()}
