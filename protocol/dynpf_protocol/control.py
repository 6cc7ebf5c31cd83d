"""Control: what hosts tell each other to keep step, beyond the messages of the topic table. Never recorded."""

from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta

from dynpf_protocol.errors import BadMessageError

__all__ = ["Beat", "Recorded", "Stop", "TickDone", "decode_control", "encode_control"]

Count = Annotated[int, Meta(ge=0)]


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
    """A process's main loop goes round; ``ticks`` is how many ticks it has behind it."""

    node: str
    boot: str
    ticks: Count


class Recorded(msgspec.Struct, frozen=True, array_like=True):
    """The recorder, by its boot, has the whole run and has closed the file."""

    boot: str
    complete: bool
    reason: str
    path: str


class Stop(msgspec.Struct, frozen=True, array_like=True):
    """Somebody asks the source to make the next tick the last."""

    node: str
    boot: str
    reason: str


Control = TypeVar("Control", bound=TickDone | Beat | Recorded | Stop)

_ENCODER = msgspec.msgpack.Encoder()


def encode_control(message: TickDone | Beat | Recorded | Stop) -> bytes:
    return _ENCODER.encode(message)


def decode_control(data: bytes, kind: type[Control]) -> Control:
    """Return the control message in ``data``; raises BadMessageError."""
    try:
        return msgspec.msgpack.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"{kind.__name__}: {error}") from error
