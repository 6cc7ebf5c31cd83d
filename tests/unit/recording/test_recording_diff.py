from pathlib import Path
from typing import Any

import pytest
from dynpf_formats.recording.diff import diff, first_field
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.journal import decode_entry, encode_entry
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.unit.recording.recorded_runs import NODELESS, Sent, changed, lockstep, write


@pytest.fixture
def compare(tmp_path: Path) -> Any:
    """Return a function that compares two lists of what was sent, having checked digest against difference."""

    def run(a: list[Sent], b: list[Sent], **options: Any) -> Any:
        left = read_recording(write(tmp_path / "a.mcap", a))
        right = read_recording(write(tmp_path / "b.mcap", b, **options))
        difference = diff(left, right)
        assert difference.same == (content_digest(left) == content_digest(right))
        assert difference.same == (difference.first is None)
        return difference

    return run


def place(first: Any) -> tuple[Any, ...]:
    return first.node, first.topic, first.tick, first.sequence, first.field, first.a, first.b


def test_boots_times_chunks_and_order_on_the_wire_do_not_count(compare: Any) -> None:
    other = lockstep(6, boot="b2", wall_ns=5)
    shuffled = sorted(other, key=lambda one: (one.topic, one.envelope.sequence))
    difference = compare(lockstep(6), shuffled, flush_every=3)
    assert difference.same
    assert {topic: (c.a, c.b, c.differ) for topic, c in difference.counts.items()} == {
        "truth/robot": (6, 6, 0),
        "sensors/overhead": (6, 6, 0),
        "estimator/state": (6, 6, 0),
    }


def test_topics_that_are_not_compared_do_not_count(compare: Any) -> None:
    sent = lockstep(3)
    assert compare(sent, [one for one in sent if one.topic != "diagnostics"]).same


@settings(derandomize=True, deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_any_changed_digit_is_found(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    sent = lockstep(3)
    topics = ("truth/robot", "sensors/overhead", "estimator/state")
    topic, sequence = data.draw(st.sampled_from(topics)), data.draw(st.integers(0, 2))
    payload = next(one.payload for one in sent if one.topic == topic and one.envelope.sequence == sequence)
    at = data.draw(st.sampled_from([n for n, byte in enumerate(payload) if chr(byte).isdigit()]))
    new = payload[:at] + bytes([payload[at] ^ 1]) + payload[at + 1 :]
    folder = tmp_path_factory.mktemp("runs")
    a = read_recording(write(folder / "a.mcap", sent))
    b = read_recording(write(folder / "b.mcap", changed(sent, topic, sequence, lambda one: one._replace(payload=new))))
    assert content_digest(a) != content_digest(b)
    first = diff(a, b).first
    assert first is not None
    assert (first.topic, first.sequence, first.tick) == (topic, sequence, sequence)


def test_one_changed_value_is_named(compare: Any) -> None:
    sent = lockstep(5)
    other = changed(
        sent,
        "sensors/overhead",
        3,
        lambda one: one._replace(payload=one.payload.replace(b'"grey":11.0', b'"grey":11.5')),
    )
    difference = compare(sent, other)
    assert place(difference.first) == ("sensors", "sensors/overhead", 3, 3, "discs[2].grey", 11.0, 11.5)
    assert difference.counts["sensors/overhead"].differ == 1
    assert difference.counts["truth/robot"].differ == 0


def test_the_first_difference_is_the_first_by_tick_then_by_node(compare: Any) -> None:
    sent = lockstep(5)

    def other_x(one: Sent) -> Sent:
        return one._replace(payload=one.payload.replace(b'"y":', b'"y":1'))

    other = changed(sent, "truth/robot", 4, other_x)
    other = changed(other, "estimator/state", 2, other_x)
    other = changed(other, "sensors/overhead", 2, other_x)
    assert compare(sent, other).first.topic == "sensors/overhead"


def test_swapped_messages_are_named(compare: Any) -> None:
    sent = lockstep(5)
    payloads = {one.envelope.sequence: one.payload for one in sent if one.topic == "truth/robot"}
    other = changed(sent, "truth/robot", 1, lambda one: one._replace(payload=payloads[2]))
    other = changed(other, "truth/robot", 2, lambda one: one._replace(payload=payloads[1]))
    assert place(compare(sent, other).first) == ("simulator", "truth/robot", 1, 1, "x", 1 / 3, 2 / 3)


def test_one_changed_stamp_is_named(compare: Any) -> None:
    sent = lockstep(5)

    def later(one: Sent) -> Sent:
        envelope = one.envelope
        return one._replace(
            envelope=type(envelope)(
                envelope.node,
                envelope.boot,
                envelope.sequence,
                envelope.tick,
                envelope.stamp_ns + 1,
                envelope.publish_ns,
            )
        )

    first = compare(sent, changed(sent, "truth/robot", 3, later)).first
    assert place(first) == ("simulator", "truth/robot", 3, 3, "stamp_ns", 150_000_000, 150_000_001)


def journal_changed(sent: list[Sent], sequence: int, **fields: Any) -> list[Sent]:
    def change(one: Sent) -> Sent:
        entry = decode_entry(one.payload)
        kept = {name: getattr(entry, name) for name in entry.__struct_fields__}
        return one._replace(payload=encode_entry(type(entry)(**{**kept, **fields})))

    return changed(sent, "journal/estimator", sequence, change)


def test_another_state_behind_the_same_messages_is_named(compare: Any) -> None:
    sent = lockstep(5)
    first = compare(sent, journal_changed(sent, 2, state="f" * 64)).first
    assert place(first) == ("estimator", "journal/estimator", 2, 1, "state", f"{2:064x}", "f" * 64)


def test_another_tick_of_the_same_message_is_named(compare: Any) -> None:
    sent = lockstep(5)
    first = compare(sent, journal_changed(sent, 3, tick=4)).first
    assert place(first) == ("estimator", "estimator/state", 3, 3, "tick", 3, 4)


def test_a_message_that_one_side_lacks_is_named(compare: Any) -> None:
    sent = lockstep(5)
    difference = compare(sent, changed(sent, "estimator/state", 4, lambda _: None))
    assert place(difference.first) == ("estimator", "estimator/state", 4, 4, "message", "present", "missing")
    assert (difference.counts["estimator/state"].a, difference.counts["estimator/state"].b) == (5, 4)


def test_a_log_record_has_the_tick_of_the_step_that_consumed_it(tmp_path: Path) -> None:
    _, robot, *_ = sent = lockstep(3)
    assert robot.envelope.node == "sensors"
    played = [
        Sent("log/truth", type(one.envelope)("log", "sensors-b1", *_rest(one)), one.payload)
        if one.topic == "truth/robot"
        else one._replace(
            payload=one.payload.replace(b'"truth/robot"', b'"log/truth"').replace(b'"simulator"', b'"log"')
        )
        for one in sent
        if not one.topic.startswith("journal/simulator")
    ]
    played = [one._replace(payload=one.payload.replace(b'"simulator-b1"', b'"sensors-b1"')) for one in played]
    recording = read_recording(write(tmp_path / "run.mcap", played, header=NODELESS))
    assert [recording.tick_of(record) for record in recording.messages("log/truth")] == [0, 1, 2]
    assert recording.end is not None
    assert recording.end.complete


def _rest(one: Sent) -> tuple[int, int, int, int]:
    envelope = one.envelope
    return envelope.sequence, envelope.tick, envelope.stamp_ns, envelope.publish_ns


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (b'{"x":1}', b'{"x":1}', None),
        (b'{"x":1,"y":2}', b'{"x":1,"y":3}', ("y", 2, 3)),
        (b'{"x":1}', b'{"x":1.0}', ("x", 1, 1.0)),
        (b'{"p":[{"x":1},{"x":2}]}', b'{"p":[{"x":1},{"x":5}]}', ("p[1].x", 2, 5)),
        (b'{"p":[1,2]}', b'{"p":[1,2,3]}', ("p.length", 2, 3)),
        (b'{"p":[1,2]}', b'{"p":[9,2,3]}', ("p[0]", 1, 9)),
        (b'{"x":1}', b'{"x":1,"y":[1]}', ("y", None, "[1]")),
        (b'{"x":1}', b'{"x": 1}', ("payload", '{"x":1}', '{"x": 1}')),
        (b"\xff", b"{}", ("payload", "\ufffd", "{}")),
    ],
)
def test_first_field(a: bytes, b: bytes, expected: tuple[Any, ...] | None) -> None:
    assert first_field(a, b) == expected


def test_long_texts_are_cut_down_to_where_they_part() -> None:
    a, b = b'{"data":"' + b"A" * 5000 + b'B"}', b'{"data":"' + b"A" * 5000 + b'C"}'
    found = first_field(a, b)
    assert found == ("data", "..." + "A" * 20 + "B", "..." + "A" * 20 + "C")
