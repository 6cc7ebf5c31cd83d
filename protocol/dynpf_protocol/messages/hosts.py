"""Messages of hosts and the recorder."""

from typing import Literal

from dynpf_protocol.messages.base import Count, Message, NonNegative
from dynpf_protocol.numbers import Count63

__all__ = [
    "Diagnostics",
    "Gap",
    "HostEvent",
    "Restart",
    "Snapshot",
]


class HostEvent(Message, frozen=True, kw_only=True):
    """An event of a node's inputs, given to the node as an input itself: a gap in a topic's sequence numbers."""

    schema_name = "dynpf.HostEvent"
    kind: Literal["gap"]
    topic: str
    node: str  # the sender
    first: Count  # sequence number
    last: Count  # sequence number


class Gap(Message, frozen=True, kw_only=True):
    """Sequence numbers that the recorder never received."""

    schema_name = "dynpf.Gap"
    topic: str
    node: str  # the sender
    boot: str
    first: Count  # sequence number
    last: Count  # sequence number


class Restart(Message, frozen=True, kw_only=True):
    """A process that was gone in mid-run has been started again, and has caught up."""

    schema_name = "dynpf.Restart"
    node: str  # the process
    before: str  # the start that was gone
    start: str  # the one that has taken over
    tick: Count  # how many ticks were recorded when it was gone
    absent_s: NonNegative  # s, by the recorder's clock; since the recorder was started again, if it was away, too


class Snapshot(Message, frozen=True, kw_only=True):
    """The whole state of a node and its host after a step, from which both go on, here or elsewhere."""

    schema_name = "dynpf.Snapshot"
    step: Count63
    tick: Count63
    chain: str  # chain value of the node's journal after the step, in hexadecimal
    state: bytes  # dynpf_protocol.snapshots has its layout; compressed by zstd


class Diagnostics(Message, frozen=True, kw_only=True):
    """Timings and counters of one process, by the wall clock."""

    schema_name = "dynpf.Diagnostics"
    node: str
    steps: Count  # so far
    step_time_s: NonNegative  # s, spent in the node's own step since the last report
    refused: dict[str, Count]  # topic -> messages refused so far
    queue: Count  # messages waiting
