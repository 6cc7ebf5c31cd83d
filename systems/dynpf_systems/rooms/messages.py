"""Messages of rooms: obstacles."""

from typing import Annotated

from dynpf_protocol.messages.base import Message, Piece, Positive
from msgspec import Meta

__all__ = ["Barrier", "Disc", "Obstacles"]


class Disc(Piece, frozen=True, kw_only=True):
    """A disc in the map, such as a person."""

    x: float  # m
    y: float  # m
    radius: Positive  # m


class Barrier(Piece, frozen=True, kw_only=True):
    """A line segment between two points."""

    x1: float  # m
    y1: float  # m
    x2: float  # m
    y2: float  # m


class Obstacles(Message, frozen=True, kw_only=True):
    """Obstacles that are in no map: people as discs, and the doors that are closed now."""

    schema_name = "dynpf.Obstacles"
    people: Annotated[tuple[Disc, ...], Meta(max_length=256)] = ()
    doors: Annotated[tuple[Barrier, ...], Meta(max_length=256)] = ()
