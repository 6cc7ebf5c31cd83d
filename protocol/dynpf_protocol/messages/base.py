"""What messages are made of: frozen structs whose types say ranges, lengths and signs."""

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

__all__ = [
    "Angle",
    "Count",
    "Message",
    "NonNegative",
    "Piece",
    "Positive",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
Count = Annotated[int, Meta(ge=0)]


class Piece(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A piece of a message; has no topic of its own."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a topic carries. ``schema_name`` is the name under which a recording files its schema."""

    schema_name: ClassVar[str]
