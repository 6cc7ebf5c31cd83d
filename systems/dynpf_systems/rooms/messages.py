"""Messages of rooms: what is in the way."""

from typing import Annotated

from dynpf_protocol.messages.base import Message, Piece, Positive
from msgspec import Meta

__all__ = ["Barrier", "Disc", "Obstacles"]


class Disc(Piece, frozen=True, kw_only=True):
    x: float  # m
    y: float  # m
    radius: Positive  # m


class Barrier(Piece, frozen=True, kw_only=True):
    """A straight piece from one end to the other."""

    x1: float  # m
    y1: float  # m
    x2: float  # m
    y2: float  # m


class Obstacles(Message, frozen=True, kw_only=True):
    """What stands in the way just now and is in no map: people as discs, and the doors that are closed."""

    schema_name = "dynpf.Obstacles"
    people: Annotated[tuple[Disc, ...], Meta(max_length=256)] = ()
    doors: Annotated[tuple[Barrier, ...], Meta(max_length=256)] = ()
