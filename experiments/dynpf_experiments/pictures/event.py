"""An event of a run."""

from typing import NamedTuple

__all__ = ["Event"]


class Event(NamedTuple):
    """Something that happened at a time, s; ``level`` is info, warning or error.

    ``kind`` is gap, log, restart, silence (of a topic), leap (of a robot, or its reference) or end.
    """

    seconds: float
    kind: str
    level: str
    node: str
    text: str
