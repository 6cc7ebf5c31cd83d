"""Control messages, by which processes keep in step and end a run. They are not in the topic table, nor recorded."""

from enum import IntEnum, StrEnum
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta

from dynpf_protocol.errors import BadMessageError, TooLargeError
from dynpf_protocol.numbers import Count63

__all__ = [
    "Act",
    "Beat",
    "Doing",
    "Outcome",
    "Pace",
    "Recorded",
    "Stop",
    "TickDone",
    "decode_control",
    "encode_control",
]


class Outcome(StrEnum):
    """Why the last step of a run was the last."""

    DONE = "task done"  # the source said so
    BUDGET = "budget spent"  # the scenario's most ticks, or the end of the log
    STOPPED = "stopped"  # by the user


_MOST_BYTES = 64 * 2**10

Name = Annotated[str, Meta(min_length=1, max_length=64)]
Text = Annotated[str, Meta(max_length=4096)]


class TickDone(msgspec.Struct, frozen=True, array_like=True):
    """A node has ended a step: how many messages it sent on each topic, and whether this was its last step."""

    node: Name
    boot: Name
    step: Count63
    tick: Count63
    stamp_ns: Count63
    counts: dict[str, Count63]
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


class Pace(msgspec.Struct, frozen=True, array_like=True):
    """How the source goes on: ``paused`` after ``steps`` more ticks, or at a rate of logical to wall-clock time.

    A rate of 0 is as fast as possible; in realtime it is 1.
    """

    paused: bool = False
    steps: Annotated[int, Meta(ge=0, le=10**6)] = 0
    rate: Annotated[float, Meta(ge=0.0, le=1e4)] = 1.0


class Beat(msgspec.Struct, frozen=True, array_like=True):
    """A heartbeat: the process has ended ``ticks`` ticks, and its main loop has been ``doing`` this for ``for_ns``.

    ``boot`` is the sender's start. A recorder says of how many ticks of each node all is in its file, ``kept``, and in
    lockstep read by all who wait for it. Once a process is ready it says which start of each process of the run counts.
    """

    node: Name
    boot: Name
    ticks: Count63
    doing: Doing = Doing.TURNING
    for_ns: Count63 = 0
    kept: dict[Name, Count63] = {}
    starts: dict[Name, Name] = {}
    pace: Pace | None = None  # of the source


class Recorded(msgspec.Struct, frozen=True, array_like=True):
    """The recorder has closed the file; ``complete`` says whether it has the whole run, else ``reason`` why not."""

    boot: Name
    complete: bool
    reason: Text
    path: Text


class Stop(msgspec.Struct, frozen=True, array_like=True):
    """A request that the source make the next tick the last."""

    node: Name
    boot: Name
    reason: Text


class Act(msgspec.Struct, frozen=True, array_like=True):
    """An operator's request to the source: a message for a topic of acts, or another ``pace`` of the run.

    ``number`` counts the requests of a ``boot``, so that none counts twice.
    """

    node: Name
    boot: Name
    number: Count63
    topic: Annotated[str, Meta(max_length=128)] = ""
    payload: Annotated[bytes, Meta(max_length=4096)] = b""
    pace: Pace | None = None


Control = TypeVar("Control", bound=TickDone | Beat | Recorded | Stop | Act)

_ENCODER = msgspec.msgpack.Encoder()


def encode_control(message: TickDone | Beat | Recorded | Stop | Act) -> bytes:
    """Return the control message as bytes."""
    return _ENCODER.encode(message)


def decode_control(data: bytes, kind: type[Control]) -> Control:
    """Return the control message in ``data``; raises BadMessageError, and TooLargeError before it is read."""
    if len(data) > _MOST_BYTES:
        raise TooLargeError(f"{kind.__name__}: {len(data)} bytes; at most {_MOST_BYTES} are allowed")
    try:
        return msgspec.msgpack.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"{kind.__name__}: {error}") from error
