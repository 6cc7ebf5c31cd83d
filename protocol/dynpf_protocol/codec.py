"""Codec: encodes messages as JSON and decodes them; refuses whatever does not fit the topic's type."""

from collections.abc import Mapping
from functools import cache

import msgspec

from dynpf_protocol.errors import BadMessageError, TooLargeError
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import TOPICS, Topic, topic

__all__ = ["decode", "encode"]

_ENCODER = msgspec.json.Encoder()


def encode(name: str, message: Message, topics: Mapping[str, Topic] = TOPICS) -> bytes:
    """Return the payload of ``message`` for topic ``name`` of ``topics``.

    Raises BadMessageError for another type than the topic's, for NaN and infinite numbers, which JSON lacks, and for
    text that UTF-8 cannot encode; TooLargeError for more bytes than the topic allows.
    """
    row = topic(name, topics)
    expected = row.type
    if type(message) is not expected:
        raise BadMessageError(f"{name}: got {type(message).__name__}, expected {expected.__name__}")
    try:
        payload = _ENCODER.encode(message)
    except UnicodeEncodeError as error:
        raise BadMessageError(f"{name}: {error}") from error
    # The encoder writes NaN and infinities as null, and no message has an optional field: a null is a bad number, or
    # part of a text; decoding finds out which.
    if b"null" in payload:
        decode(name, payload, topics)
    if len(payload) > row.most_bytes:
        raise TooLargeError(f"{name}: a message of {len(payload)} bytes; at most {row.most_bytes} are allowed")
    return payload


def decode(name: str, payload: bytes, topics: Mapping[str, Topic] = TOPICS) -> Message:
    """Return the message in ``payload``; raises BadMessageError naming the topic, the field and what was expected."""
    decoder = _decoder(topic(name, topics).type)
    try:
        return decoder.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"{name}: {error}") from error


@cache
def _decoder(kind: type[Message]) -> msgspec.json.Decoder[Message]:
    return msgspec.json.Decoder(kind)
