"""An event of a run."""

from typing import NamedTuple

from dynpf_protocol.messages import Message
from dynpf_protocol.printable import printable
from msgspec import structs

__all__ = ["Event", "act_in_words"]


class Event(NamedTuple):
    """Something that happened at a time, s; ``level`` is info, warning or error.

    ``kind`` is gap, log, restart, act (of a person), silence (of a topic), leap (of a robot, or its reference) or end.
    """

    seconds: float
    kind: str
    level: str
    node: str
    text: str


def act_in_words(topic: str, act: Message) -> str:
    """Return what a person did, in a few words."""
    told = ", ".join(f"{name} {value}" for name, value in structs.asdict(act).items())
    return printable(f"{topic}: {told}", 200)
