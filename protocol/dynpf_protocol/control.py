"""Control messages, by which processes keep in step and end a run. They are not in the topic table, nor recorded."""

from typing import TypeVar

import msgspec

from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.numbers import Count

__all__ = ["Beat", "Recorded", "Stop", "TickDone", "decode_control", "encode_control"]


class TickDone(msgspec.Struct, frozen=True, array_like=True):
    """A node has ended a step: how many messages it sent on each topic, and whether this was its last step."""

    node: str
    boot: str
    step: Count
    tick: Count
    stamp_ns: Count
    counts: dict[str, Count]
    last: bool


class Beat(msgspec.Struct, frozen=True, array_like=True):
    """A heartbeat: the process's main loop is alive and has ended ``ticks`` ticks."""

    node: str
    boot: str
    ticks: Count


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
