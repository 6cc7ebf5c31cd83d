"""Which studies there are, and where each is found; a study is loaded only when it is asked for."""

from importlib import import_module
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

if TYPE_CHECKING:
    from dynpf_lab.studies.study import Study

__all__ = ["NAMES", "study_named"]

_MODULES = {
    "colon-particles": "colon",
    "colon-cases": "colon",
    "colon-growth": "colon",
    "colon-hypotheses": "colon",
    "indoor": "indoor",
    "landmark": "landmark",
    "turtlebot": "turtlebot",
    "kidnap": "kidnap",
    "parts-3": "parts_studies",
    "parts-6": "parts_studies",
    "parts-bounds": "parts_bounds",
    "parts-time": "parts_time",
    "parts-vision": "parts_vision",
    "parts-layouts": "parts_layouts",
}

NAMES = tuple(_MODULES)


def study_named(name: str) -> "Study":
    """Return a study by its name; raises UsageError, which names those that there are."""
    if name not in _MODULES:
        raise UsageError(f"unknown study {name!r}; expected one of {', '.join(NAMES)}")
    studies: dict[str, Study] = import_module(f"dynpf_lab.studies.{_MODULES[name]}").STUDIES
    return studies[name]
