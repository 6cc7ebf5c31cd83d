import pytest
from dynpf_protocol.codec import encode
from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.keys import DATA, TICK
from dynpf_protocol.messages import Odometry
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.intake import Intake, Refusal
from dynpf_runtime.node import Received
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode, graph_of

BOOTS = {"sensors": "s1", "simulator": "w1"}
TOPIC = "sensors/odometry"
GRAPH = graph_of(
    [
        ToyNode("sensors", reads=["log/odometry"], writes=[TOPIC]),
        ToyNode("estimator", reads=[TOPIC], writes=["estimator/pose"]),
    ]
)
MESSAGE = Odometry(v=1.0, w=0.5)
PAYLOAD = encode(TOPIC, MESSAGE)


def intake() -> Intake:
    return Intake(BOOTS, GRAPH)


def arrival(
    sequence: int = 0, *, topic: str = TOPIC, node: str = "sensors", boot: str = "s1", payload: bytes = PAYLOAD
) -> Arrived:
    return Arrived(DATA + topic, payload, encode_envelope(Envelope(node, boot, sequence, 3, 30, 300)))


def test_a_good_message_becomes_an_input() -> None:
    accepted = intake().accept(arrival(5))
    assert not isinstance(accepted, Refusal)
    assert accepted[0] == Received(TOPIC, "sensors", "s1", 5, 30, MESSAGE)
    assert accepted[1] == Envelope("sensors", "s1", 5, 3, 30, 300)


REFUSED = {
    "topic 'no/topic' is not in the topic table": arrival(topic="no/topic"),
    "unreadable envelope: Input data was truncated": Arrived(DATA + TOPIC, PAYLOAD, b""),
    "unreadable envelope: Expected `int` >= 0": Arrived(DATA + TOPIC, PAYLOAD, b"\x96\xa1a\xa1b\xff\x00\x00\x00"),
    "unreadable envelope: 'utf-8' codec": Arrived(DATA + TOPIC, PAYLOAD, b"\x96\xa2\xc2a\xa1b\x00\x00\x00\x00"),
    "unknown sender 'vision'; expected sensors": arrival(node="vision"),
    "unknown sender 'estimator' with boot 's1'; this run's is None": arrival(
        topic="estimator/pose", node="estimator", boot="s1"
    ),
    "unknown sender 'sensors' with boot 'old'; this run's is 's1'": arrival(boot="old"),
    "unknown sender 'log' with boot 'w1'; this run's is 's1'": arrival(topic="log/odometry", node="log", boot="w1"),
    "it comes in the name of 'sensors'; its key is that of 'vision'": arrival()._replace(key=f"{DATA}log/-/vision"),
    "it comes in the name of 'sensors'; its key is that of ''": arrival()._replace(key=f"{DATA}log"),
    "it comes in the name of 'sensors'; its key is that of 'x'": arrival()._replace(key=f"{DATA}{TOPIC}/-/x"),
    "sensors/odometry: Object missing required field `w`": arrival(payload=b'{"v":1}'),
    "sensors/odometry: Expected `float`, got `str` - at `$.v`": arrival(payload=b'{"v":"fast","w":0}'),
    "sensors/odometry: Object contains unknown field `x`": arrival(payload=b'{"v":1,"w":0,"x":0}'),
    "sensors/odometry: JSON is malformed": arrival(payload=b"?"),
    "sensors/odometry: 'utf-8' codec": arrival(payload=b'{"\xff":1}'),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_bad_messages_are_refused_with_the_reason_and_then_a_good_one_is_accepted(reason: str) -> None:
    box = intake()
    bad = REFUSED[reason]
    refusal = box.accept(bad)
    assert isinstance(refusal, Refusal)
    assert refusal.reason.startswith(reason)
    assert refusal.first_of_its_kind
    # Only a message of a genuine sender may count as come, so that nobody waits for it.
    assert (refusal.envelope is not None) == reason.startswith("sensors/odometry:")
    assert box.refused == {bad.key[len(DATA) :].partition("/-/")[0]: 1}
    assert not isinstance(box.accept(arrival(1)), Refusal)


def test_log_records_carry_the_boot_of_the_source() -> None:
    assert not isinstance(intake().accept(arrival(topic="log/odometry", node="log", boot="s1")), Refusal)


def test_sequence_numbers_that_come_again_are_refused_and_jumps_are_not() -> None:
    box = intake()
    outcomes = [box.accept(arrival(sequence)) for sequence in (0, 1, 1, 0, 5, 4, 6)]
    assert [isinstance(one, Refusal) for one in outcomes] == [False, False, True, True, False, True, False]
    assert [one.reason for one in outcomes if isinstance(one, Refusal)] == [
        "sequence 1 again; expected 2 or later",
        "sequence 0 again; expected 2 or later",
        "sequence 4 again; expected 6 or later",
    ]
    assert not any(one.envelope for one in outcomes if isinstance(one, Refusal))
    assert not isinstance(box.accept(arrival(0, topic="log/odometry", node="log")), Refusal)  # its own sequence


def test_each_kind_of_refusal_is_told_once_and_all_are_counted() -> None:
    box = intake()
    told = [box.accept(arrival(sequence, payload=b"?")) for sequence in range(4)]
    told += [box.accept(arrival(boot="old"))]
    assert [one.first_of_its_kind for one in told if isinstance(one, Refusal)] == [True, False, False, False, True]
    assert box.refused == {TOPIC: 5}


def test_a_flood_of_different_reasons_is_not_told_for_ever() -> None:
    box = intake()
    told = [box.accept(arrival(boot=f"b{number}")) for number in range(300)]
    assert sum(one.first_of_its_kind for one in told if isinstance(one, Refusal)) == 100
    assert box.refused[TOPIC] == 300


@settings(derandomize=True, deadline=None, max_examples=300)
@given(payload=st.binary(max_size=40), attachment=st.binary(max_size=40), key=st.text(max_size=10))
def test_no_bytes_whatever_get_past_or_stop_it(payload: bytes, attachment: bytes, key: str) -> None:
    box = intake()
    good = arrival()
    assert isinstance(box.accept(Arrived(good.key, payload, attachment)), Refusal)
    assert isinstance(box.accept(Arrived(good.key, payload, good.attachment)), Refusal)
    assert isinstance(box.accept(Arrived(DATA + key, payload, good.attachment)), Refusal)
    assert isinstance(box.accept_tick(Arrived(TICK + "sensors", payload, b"")), Refusal)
    assert not isinstance(box.accept(arrival(1)), Refusal)


def test_the_end_of_a_tick_counts_only_from_a_peer_of_this_run() -> None:
    def tick(key: str, node: str, boot: str) -> TickDone | Refusal:
        return box.accept_tick(Arrived(TICK + key, encode_control(TickDone(node, boot, 0, 0, 0, {}, True)), b""))

    box = intake()
    assert tick("sensors", "sensors", "s1") == TickDone("sensors", "s1", 0, 0, 0, {}, True)
    refused = [tick("sensors", "sensors", "old"), tick("simulator", "sensors", "s1"), tick("vision", "vision", "v")]
    assert [one.reason for one in refused if isinstance(one, Refusal)] == [
        "unknown sender 'sensors' with boot 'old'",
        "unknown sender 'sensors' with boot 's1'",
        "unknown sender 'vision' with boot 'v'",
    ]
    assert box.refused == {"tick/sensors": 1, "tick/simulator": 1, "tick/vision": 1}
