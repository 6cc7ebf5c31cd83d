"""The studies of the systems, and the user's own; a study is loaded only when it is requested."""

from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_formats.shipped import listed, load
from dynpf_formats.user_classes import UserClass
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.user_code import add_folders, find_value

if TYPE_CHECKING:
    from dynpf_experiments.study import Study

__all__ = ["study_named", "study_names"]


def study_names() -> list[str]:
    """Return the names of the studies in alphabetical order."""
    return sorted(_listed())


def study_named(name: str) -> "Study":
    """Return a study by its name, or STUDY of a Python file; raises UsageError, which lists the known names."""
    if name.endswith(".py"):
        return _own(Path(name))
    listed = _listed()
    if name not in listed:
        raise UsageError(f"unknown study {name!r}; expected one of {', '.join(study_names())}")
    found: Study = load(listed[name])
    return found


def _own(path: Path) -> "Study":
    from dynpf_experiments.study import Study  # noqa: PLC0415 - completion of the names does without

    if not path.is_file():
        raise UsageError(f"{path}: no such file; expected a module of yours with a STUDY")
    add_folders([path.parent])
    return find_value(UserClass(str(path), path.stem, "STUDY"), Study, "study")


def _listed() -> dict[str, str]:
    return {name: text for studies in listed("STUDIES") for name, text in studies.items()}
