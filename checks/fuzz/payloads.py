"""Hostile payloads of every topic, envelopes, control messages and journal entries, and what decodes them."""

from collections.abc import Callable
from functools import cache
from random import Random
from typing import Any

import msgspec
from dynpf_formats.shipped import known_topics
from dynpf_protocol import control
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope, decode_envelope, encode_envelope
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JournalEntry, decode_entry
from msgspec import inspect

from checks.fuzz.cases import Trial
from checks.fuzz.trial import WrongAnswerError
from checks.fuzz.values import Values, as_json, torn

__all__ = ["payload_case"]

_CONTROL = (control.TickDone, control.Beat, control.Recorded, control.Stop)


def payload_case(number: int, seed: int) -> Trial:
    """Return the trial of one payload, made by its number alone."""
    random = Random(f"payload {seed}/{number}")
    values = Values(random)
    match random.choices(("message", "envelope", "control", "journal"), (7, 1, 2, 1))[0]:
        case "envelope":
            return Trial("envelope", _taken(_packed(values, Envelope), decode_envelope, encode_envelope))
        case "control":
            kind = random.choice(_CONTROL)
            data = _packed(values, kind)
            return Trial(
                "control", _taken(data, lambda data: control.decode_control(data, kind), control.encode_control)
            )
        case "journal":
            return Trial("journal", lambda: _entry(_text(values, JournalEntry)))
    name = random.choice([*known_topics()])
    return Trial("message", _message(name, _text(values, known_topics()[name].type)))


def _message(name: str, payload: bytes) -> Callable[[], None]:
    topics = known_topics()
    return _taken(payload, lambda data: decode(name, data, topics), lambda message: encode(name, message, topics))


def _taken(data: bytes, read: Callable[[bytes], Any], write: Callable[[Any], bytes]) -> Callable[[], None]:
    """Return the trial that what is read from ``data`` can be written, and read again as the same."""

    def action() -> None:
        message = read(data)
        if read(write(message)) != message:
            raise WrongAnswerError("written and read again, the message is another")

    return action


def _entry(payload: bytes) -> None:
    try:
        decode_entry(payload)
    except msgspec.DecodeError as error:
        raise BadMessageError(str(error)) from error


def _text(values: Values, kind: type) -> bytes:
    """Return a payload in JSON."""
    document = values.changed(_plain(kind)) if values.random.random() < 0.95 else values.value()
    data = as_json(document).encode(errors="surrogatepass")
    return torn(data, values.random) if values.random.random() < 0.1 else data


def _packed(values: Values, kind: type) -> bytes:
    """Return a message in MessagePack."""
    document = values.changed([*_plain(kind).values()])
    try:
        data = msgspec.msgpack.encode(document)
    except (OverflowError, UnicodeEncodeError):
        data = b"\xdd\xff\xff\xff\xff"
    if values.random.random() < 0.02:
        return values.random.choice((b"\x91" * 100_000, b"", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff"))
    return torn(data, values.random) if values.random.random() < 0.3 else data


@cache
def _plain(kind: type) -> Any:
    return _of(inspect.type_info(kind))


def _of(info: inspect.Type) -> Any:
    """Return a plain value that a type admits, as JSON has it."""
    match info:
        case inspect.StructType(fields=fields):
            return {field.encode_name: _of(field.type) for field in fields}
        case inspect.FloatType():
            return 1.0
        case inspect.IntType(ge=low):
            return low or 0
        case inspect.BoolType():
            return True
        case inspect.BytesType():
            return "AA=="
        case inspect.LiteralType(values=choices):
            return choices[0]
        case inspect.EnumType(cls=cls):
            return next(iter(cls)).value
        case inspect.VarTupleType(item_type=item, min_length=low):
            return [_of(item) for _ in range(low or 1)]
        case inspect.DictType():
            return {"text": 1}
        case inspect.UnionType(types=types):
            return _of(next(one for one in types if not isinstance(one, inspect.NoneType)))
    return "text"
