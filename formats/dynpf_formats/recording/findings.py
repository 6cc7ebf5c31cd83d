"""What can be found about a recording, and how bad it is."""

from enum import StrEnum

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.topics import is_compared

__all__ = ["Finding", "Severity", "by_topic", "error", "warning"]


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


def by_topic(what: str, topic: str) -> Finding:
    """Return a finding about a topic: an error if it is compared, or a journal."""
    if topic.startswith(JOURNAL_PREFIX) or is_compared(topic):
        return error(what, topic)
    return warning(f"{what}; this topic is not compared", topic)
