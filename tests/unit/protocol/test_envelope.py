"""Envelopes, control messages and journal entries come through unchanged; anything else is refused as such."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import msgspec
import pytest
from dynpf_protocol.control import Beat, Recorded, Stop, TickDone, decode_control, encode_control
from dynpf_protocol.envelope import Envelope, decode_envelope, encode_envelope
from dynpf_protocol.errors import BadEnvelopeError, BadMessageError, ProtocolError
from dynpf_protocol.journal import Consumed, JournalEntry, Produced, decode_entry, encode_entry
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.protocol.built_messages import built

ENVELOPE = Envelope("estimator", "b7", 3, 5, 250_000_000, 1_700_000_000_000_000_000)
CONTROL: list[type[TickDone | Beat | Recorded | Stop]] = [TickDone, Beat, Recorded, Stop]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(envelope=built(Envelope))
def test_an_envelope_comes_back_equal(envelope: Envelope) -> None:
    assert decode_envelope(encode_envelope(envelope)) == envelope


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("node", ""),
        ("node", "x" * 65),
        ("boot", ""),
        ("sequence", -1),
        ("sequence", 2**32),
        ("tick", -1),
        ("stamp_ns", -1),
        ("stamp_ns", 2**63),
        ("publish_ns", 1.5),
    ],
)
def test_an_envelope_out_of_range_is_refused(field: str, value: object) -> None:
    with pytest.raises(BadEnvelopeError, match="unreadable envelope"):
        decode_envelope(encode_envelope(msgspec.structs.replace(ENVELOPE, **{field: value})))


def test_an_envelope_with_a_missing_or_a_further_part_is_refused() -> None:
    parts = msgspec.msgpack.decode(encode_envelope(ENVELOPE))
    assert decode_envelope(msgspec.msgpack.encode(parts)) == ENVELOPE
    for wrong in (parts[:-1], [*parts, 0], {"node": "x"}):
        with pytest.raises(BadEnvelopeError):
            decode_envelope(msgspec.msgpack.encode(wrong))


@settings(max_examples=300, derandomize=True, deadline=None)
@given(data=st.binary(max_size=48))
def test_any_bytes_for_an_envelope_or_control_message_are_read_or_refused(data: bytes) -> None:
    of_control: list[Callable[[bytes], object]] = [partial(decode_control, kind=kind) for kind in CONTROL]
    for read in (decode_envelope, *of_control):
        with suppress(ProtocolError):
            read(data)


def test_truncated_and_flipped_envelopes_are_read_or_refused() -> None:
    data = encode_envelope(ENVELOPE)
    for end in range(len(data)):
        with pytest.raises(BadEnvelopeError):
            decode_envelope(data[:end])
    for place in range(len(data) * 8):
        flipped = bytearray(data)
        flipped[place // 8] ^= 1 << place % 8
        try:
            assert isinstance(decode_envelope(bytes(flipped)), Envelope)
        except BadEnvelopeError:
            continue


@pytest.mark.parametrize("kind", CONTROL)
@settings(max_examples=50, derandomize=True, deadline=None)
@given(data=st.data())
def test_a_control_message_comes_back_equal_and_cannot_be_taken_for_another(kind: type, data: st.DataObject) -> None:
    message = data.draw(built(kind))
    encoded = encode_control(message)
    assert decode_control(encoded, kind) == message
    for other in CONTROL:
        if other is not kind:
            try:
                decode_control(encoded, other)
            except BadMessageError as error:
                assert str(error).startswith(other.__name__)


def test_deeply_nested_envelopes_and_control_messages_are_refused() -> None:
    data = b"\x91" * 100_000  # arrays of one array
    with pytest.raises(BadEnvelopeError):
        decode_envelope(data)
    with pytest.raises(BadMessageError):
        decode_control(data, TickDone)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(entry=built(JournalEntry))
def test_a_journal_entry_comes_back_equal_with_its_references_in_order(entry: JournalEntry) -> None:
    assert decode_entry(encode_entry(entry)) == entry


def test_a_journal_entry_that_is_none_is_refused() -> None:
    entry = JournalEntry(
        step=1,
        tick=1,
        stamp_ns=5,
        consumed=(Consumed("simulator", "b1", "truth/robot", 1),),
        produced=(Produced("sensors/odometry", 1),),
    )
    data = encode_entry(entry)
    assert decode_entry(data) == entry
    spoilt = [(b'"tick":1', b'"tick":-1'), (b'"step"', b'"stop"'), (b"truth", b"tru\xffh")]
    for wrong in (b"", b"{}", data[:-1], b"[" * 100_000, *(data.replace(*change) for change in spoilt)):
        with pytest.raises(msgspec.DecodeError):
            decode_entry(wrong)
