"""What can be found about a recording, and how bad it is."""

from enum import StrEnum

import msgspec

__all__ = ["Finding", "Severity", "error", "warning"]


class Severity(StrEnum):
    """How bad a finding is."""

    UNREADABLE = "unreadable"  # the file cannot be read as a recording
    ERROR = "error"  # a part of the run is lost or wrong
    WARNING = "warning"  # something is odd


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong; ``where`` locates it in the file or the run."""

    severity: Severity
    what: str
    where: str


def error(what: str, where: str) -> Finding:
    """Return what says that a part of the run is lost or wrong."""
    return Finding(severity=Severity.ERROR, what=what, where=where)


def warning(what: str, where: str) -> Finding:
    """Return what says that something is odd."""
    return Finding(severity=Severity.WARNING, what=what, where=where)
