"""The base classes of messages and their parts: frozen structs whose types give ranges, lengths and signs."""

from typing import ClassVar

import msgspec

from dynpf_protocol.numbers import Angle, Count, NonNegative, Positive

__all__ = [
    "Angle",
    "Count",
    "Message",
    "NonNegative",
    "Piece",
    "Positive",
]


class Piece(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A part of a message, without a topic of its own."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of a topic. ``schema_name`` is the name of its schema in recordings."""

    schema_name: ClassVar[str]
