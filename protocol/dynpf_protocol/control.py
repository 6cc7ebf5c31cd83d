"""Control messages, by which processes keep in step and end a run. They are not in the topic table, nor recorded."""

from enum import IntEnum, StrEnum
from typing import TypeVar

import msgspec

from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.numbers import Count

__all__ = ["Beat", "Doing", "Outcome", "Recorded", "Stop", "TickDone", "decode_control", "encode_control"]


class Outcome(StrEnum):
    """Why the last step of a run was the last."""

    DONE = "task done"  # the source said so
    BUDGET = "budget spent"  # the scenario's most ticks, or the end of the log
    STOPPED = "stopped"  # by the user


class TickDone(msgspec.Struct, frozen=True, array_like=True):
    """A node has ended a step: how many messages it sent on each topic, and whether this was its last step."""

    node: str
    boot: str
    step: Count
    tick: Count
    stamp_ns: Count
    counts: dict[str, Count]
    last: bool
    outcome: Outcome | None = None  # of the source's last step


class Doing(IntEnum):
    """What a process's main loop does."""

    STARTING = 0  # it has no loop yet: it loads, compiles, and looks for the router
    TURNING = 1  # it waits for an event, or handles one
    STEP = 2  # it is in a node's step, which may take long
    BUS = 3  # it hands something to the bus, which may hold it up
    FILE = 4  # it writes the recording
    ENDED = 5  # its loop is over


class Beat(msgspec.Struct, frozen=True, array_like=True):
    """A heartbeat: the process has ended ``ticks`` ticks, and its main loop has been ``doing`` this for ``for_ns``."""

    node: str
    boot: str
    ticks: Count
    doing: Doing = Doing.TURNING
    for_ns: Count = 0


class Recorded(msgspec.Struct, frozen=True, array_like=True):
    """The recorder has closed the file; ``complete`` says whether it has the whole run, else ``reason`` why not."""

    boot: str
    complete: bool
    reason: str
    path: str


class Stop(msgspec.Struct, frozen=True, array_like=True):
    """A request that the source make the next tick the last."""

    node: str
    boot: str
    reason: str


Control = TypeVar("Control", bound=TickDone | Beat | Recorded | Stop)

_ENCODER = msgspec.msgpack.Encoder()


def encode_control(message: TickDone | Beat | Recorded | Stop) -> bytes:
    """Return the control message as bytes."""
    return _ENCODER.encode(message)


def decode_control(data: bytes, kind: type[Control]) -> Control:
    """Return the control message in ``data``; raises BadMessageError."""
    try:
        return msgspec.msgpack.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"{kind.__name__}: {error}") from error
