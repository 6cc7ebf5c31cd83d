"""Wishes: what a browser asks for, checked before it becomes a request to the source of a run."""

from collections.abc import Mapping
from typing import Annotated

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Pace
from dynpf_protocol.errors import BadMessageError, ProtocolError
from dynpf_protocol.topics import Topic
from msgspec import Meta

__all__ = ["MOST_BYTES", "Wish", "checked"]

MOST_BYTES = 4096
"""Of a request's body."""


class Wish(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An act for a topic, or another pace."""

    topic: Annotated[str, Meta(max_length=128)] = ""
    act: msgspec.Raw = msgspec.Raw(b"")
    pace: Pace | None = None


class _PaceWish(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pace as JSON has it, by names."""

    paused: bool = False
    steps: Annotated[int, Meta(ge=0, le=1000)] = 0
    rate: Annotated[float, Meta(ge=0.0, le=1000.0)] = 1.0


class _Asked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    topic: Annotated[str, Meta(max_length=128)] = ""
    act: msgspec.Raw = msgspec.Raw(b"")
    pace: _PaceWish | None = None


def checked(body: bytes, acts: Mapping[str, Topic]) -> Wish:
    """Return the wish in a request's body; ``acts`` has the topics of acts that the run takes.

    Raises BadMessageError for one that is not in the right form, of the wrong type, or out of range.
    """
    try:
        asked = msgspec.json.decode(body, type=_Asked)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"the request: {error}") from error
    if asked.pace is not None:
        if asked.topic or bytes(asked.act):
            raise BadMessageError("the request: an act, or a pace; not both")
        return Wish(pace=Pace(asked.pace.paused, asked.pace.steps, asked.pace.rate))
    if asked.topic not in acts:
        raise BadMessageError(f"{asked.topic!r}: this run takes no such acts; it takes {', '.join(sorted(acts))}")
    try:
        decode(asked.topic, bytes(asked.act), acts)
    except ProtocolError as error:
        raise BadMessageError(str(error)) from error
    return Wish(asked.topic, msgspec.Raw(bytes(asked.act)))
