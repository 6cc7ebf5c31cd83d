"""The codec brings every message through unchanged, and refuses whatever else comes with one kind of error."""

import itertools
import json
import math
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.errors import BadMessageError, UnknownTopicError
from dynpf_protocol.messages import (
    Estimate,
    LandmarkReading,
    LandmarkReadings,
    Log,
    LogLevel,
    Odometry,
    PosesInFrame,
    RobotState,
    planar_pose,
    timestamp,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.protocol.built_messages import built, plainest

TOPICS = known_topics()

topics = pytest.mark.parametrize("name", TOPICS)


@topics
@settings(max_examples=20, derandomize=True, deadline=None)
@given(data=st.data())
def test_every_message_of_a_topic_comes_back_equal_and_gives_the_same_bytes(name: str, data: st.DataObject) -> None:
    message = data.draw(built(TOPICS[name].type))
    payload = encode(name, message, TOPICS)
    back = decode(name, payload, TOPICS)
    assert back == message
    assert encode(name, back, TOPICS) == payload


@settings(max_examples=300, derandomize=True, deadline=None)
@given(v=st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_keeps_all_its_bits(v: float) -> None:
    back = decode("sensors/odometry", encode("sensors/odometry", Odometry(v=v, w=0.0)))
    assert isinstance(back, Odometry)
    assert (back.v.hex(), math.copysign(1.0, back.v)) == (v.hex(), math.copysign(1.0, v))


def _float_fields(value: Any, path: str = "$") -> Iterator[tuple[str, list[Any]]]:
    """Yield the place of every float in plain values, as msgspec writes it, with the keys that lead there."""

    def walk(value: Any, path: str, keys: list[Any]) -> Iterator[tuple[str, list[Any]]]:
        if isinstance(value, float):
            yield path, keys
        elif isinstance(value, dict):
            for key, inner in value.items():
                yield from walk(inner, f"{path}.{key}", [*keys, key])
        elif isinstance(value, list | tuple):
            for index, inner in enumerate(value):
                yield from walk(inner, f"{path}[{index}]", [*keys, index])

    yield from walk(value, path, [])


@topics
def test_nan_and_infinity_are_refused_at_encoding_and_the_field_is_named(name: str) -> None:
    kind = TOPICS[name].type
    plain = msgspec.to_builtins(plainest(kind))
    places = list(_float_fields(plain))
    if kind in {RobotState, Odometry, Estimate, PosesInFrame}:
        assert places
    for (path, keys), bad in itertools.product(places, (math.nan, math.inf, -math.inf)):
        spoilt = json.loads(json.dumps(plain))
        *front, final = keys
        inner = spoilt
        for key in front:
            inner = inner[key]
        inner[final] = bad
        # Built without validation, as a node builds its messages: a range would stop an infinity, but not a NaN.
        with pytest.raises(BadMessageError) as refused:
            encode(name, _unchecked(kind, spoilt), TOPICS)
        assert name in str(refused.value)
        assert path in str(refused.value)


def _unchecked(kind: type, plain: dict[str, Any]) -> Any:
    info = msgspec.inspect.type_info(kind)

    def build(info: Any, value: Any) -> Any:
        if isinstance(info, msgspec.inspect.StructType):
            return info.cls(**{field.name: build(field.type, value[field.name]) for field in info.fields})
        if isinstance(info, msgspec.inspect.VarTupleType):
            return tuple(build(info.item_type, one) for one in value)
        return value

    return build(info, plain)


def test_the_word_null_in_a_text_is_no_bad_number() -> None:
    log = Log(timestamp=timestamp(0), level=LogLevel.INFO, message="a null, and null", name="null")
    assert decode("log", encode("log", log)) == log


def test_text_that_is_none_is_refused_at_encoding() -> None:
    log = Log(timestamp=timestamp(0), level=LogLevel.INFO, message="half a pair: \ud800", name="vision")
    with pytest.raises(BadMessageError, match=r"^log: .*surrogates not allowed"):
        encode("log", log)


def test_a_message_of_another_topic_is_refused() -> None:
    with pytest.raises(BadMessageError, match="sensors/odometry: got RobotState, expected Odometry"):
        encode("sensors/odometry", RobotState(x=0.0, y=0.0, theta=0.0))


def test_a_topic_outside_the_table_is_refused_both_ways() -> None:
    with pytest.raises(UnknownTopicError, match="'sensors/sonar'"):
        encode("sensors/sonar", Odometry(v=0.0, w=0.0))
    with pytest.raises(UnknownTopicError, match="'sensors/sonar'"):
        decode("sensors/sonar", b"{}")


@pytest.mark.parametrize(
    ("payload", "told"),
    [
        (b"", "truncated"),
        (b"{}", "missing required field `v`"),
        (b"null", "got `null`"),
        (b"[1, 2]", "got `array`"),
        (b'{"v": 1.0}', "missing required field `w`"),
        (b'{"v": 1.0, "w": "fast"}', r"\$\.w"),
        (b'{"v": 1.0, "w": true}', r"\$\.w"),
        (b'{"v": 1.0, "w": null}', r"\$\.w"),
        (b'{"v": 1.0, "w": NaN}', "malformed"),
        (b'{"v": 1.0, "w": 1e999}', "out of range"),
        (b'{"v": 1.0, "w": 2.0, "u": 3.0}', "unknown field `u`"),
        (b'{"v": 1.0, "w": 2.0} {}', "trailing"),
        (b'{"v": 1.0, "w": 2.0, "\xff": 1}', "utf-8"),
        (b"\x00\xff\xfe", "malformed"),
    ],
)
def test_what_is_not_the_topics_message_is_refused_and_told(payload: bytes, told: str) -> None:
    with pytest.raises(BadMessageError, match=f"^sensors/odometry: .*{told}"):
        decode("sensors/odometry", payload)


def _refused(name: str, message: Any, told: str) -> None:
    payload = msgspec.json.encode(message)
    with pytest.raises(BadMessageError, match=told):
        decode(name, payload, TOPICS)


def test_ranges_are_checked() -> None:
    reading = LandmarkReading(landmark=3, range=1.0, bearing=0.5)
    good = LandmarkReadings(readings=(reading,))
    assert decode("sensors/landmarks", msgspec.json.encode(good)) == good
    for field, value in [("range", -1e-9), ("bearing", 7.5), ("bearing", -7.5), ("landmark", -1)]:
        bad = LandmarkReadings(readings=(msgspec.structs.replace(reading, **{field: value}),))
        _refused("sensors/landmarks", bad, rf"readings\[0\]\.{field}")


def test_lengths_are_checked() -> None:
    pose = planar_pose(0.0, 0.0, 0.0)

    def cloud(count: int) -> PosesInFrame:
        return PosesInFrame(timestamp=timestamp(0), frame_id="map", poses=(pose,) * count)

    assert decode("estimator/particles", msgspec.json.encode(cloud(200))) == cloud(200)
    _refused("estimator/particles", cloud(201), "length <= 200")
    for count in (0, 8, 10):
        _refused("estimator/state", Estimate(x=0.0, y=0.0, theta=0.0, covariance=(0.1,) * count, n_eff=1.0), "length")


@pytest.mark.parametrize("opening", [b"[", b'{"a":', b'{"v":[', b'{"v":{"v":'])
def test_deep_nesting_is_refused_without_exhausting_the_stack(opening: bytes) -> None:
    for name in ("sensors/odometry", "truth/scene"):
        with pytest.raises(BadMessageError):
            decode(name, opening * 100_000)


@topics
def test_every_truncation_is_refused(name: str) -> None:
    payload = encode(name, plainest(TOPICS[name].type), TOPICS)
    for end in range(0, len(payload), max(1, len(payload) // 200)):
        with pytest.raises(BadMessageError):
            decode(name, payload[:end], TOPICS)


@topics
def test_a_flipped_bit_gives_a_message_of_the_topic_or_a_refusal(name: str) -> None:
    payload = encode(name, plainest(TOPICS[name].type), TOPICS)
    refusals = 0
    for place in range(0, len(payload), max(1, len(payload) // 100)):
        for bit in range(8):
            flipped = bytearray(payload)
            flipped[place] ^= 1 << bit
            try:
                message = decode(name, bytes(flipped), TOPICS)
            except BadMessageError:
                refusals += 1
            else:
                assert type(message) is TOPICS[name].type
    assert refusals > 0


@settings(max_examples=300, derandomize=True, deadline=None)
@given(payload=st.binary(max_size=64), name=st.sampled_from(list(TOPICS)))
def test_any_bytes_give_a_message_or_a_refusal(payload: bytes, name: str) -> None:
    try:
        message = decode(name, payload, TOPICS)
    except BadMessageError:
        return
    assert type(message) is TOPICS[name].type
