"""Intake: a bad message is refused with its reason, told of at a bounded rate, and the good one after it is taken."""

import pytest
from dynpf_protocol.codec import encode
from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import BadMessageError, ProtocolError, UnknownSenderError
from dynpf_protocol.keys import DATA, TICK
from dynpf_protocol.messages import Odometry
from dynpf_protocol.topics import MOST_BYTES
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.inbox import LockstepInbox
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.intake import Intake, Refusal
from dynpf_runtime.machines.refusals import AGAIN_NS, Refusals, known_names
from dynpf_runtime.machines.roles import MOST_BYTES_OF_A_TICK, MOST_OF_A_TICK, Roles
from dynpf_runtime.node import Received
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode, graph_of

BOOTS = {"sensors": "s1", "controller": "c1"}
TOPIC = "sensors/odometry"
GRAPH = graph_of(
    [
        ToyNode("sensors", reads=["log/odometry"], writes=[TOPIC]),
        ToyNode("estimator", reads=[TOPIC, "log/odometry"], writes=["estimator/pose"]),
        ToyNode("controller", writes=["controller/command"]),
    ]
)
PLAN = plan_of(load_scenario("landmark-room"))._replace(graph=GRAPH, tick_ns=10, plays_log=True)
BY_CLOCK = PLAN._replace(plays_log=False)
MESSAGE = Odometry(v=1.0, w=0.5)
PAYLOAD = encode(TOPIC, MESSAGE)


class Box(LockstepInbox):
    """The estimator's inbox, which shows what it was given."""

    def __init__(self) -> None:
        super().__init__(GRAPH, "estimator", FaultyLink((), "estimator", 1))
        self.given: list[Received] = []

    def deliver(self, received: Received, tick: int, _now_ns: int = 0) -> None:
        self.given.append(received)
        super().deliver(received, tick)


def intake() -> tuple[Intake, Box]:
    box = Box()
    return Intake(Roles(PLAN, BOOTS), box), box


def arrival(
    sequence: int = 0,
    *,
    topic: str = TOPIC,
    node: str = "sensors",
    boot: str = "s1",
    payload: bytes = PAYLOAD,
    tick: int = 0,
) -> Arrived:
    return Arrived(DATA + topic, payload, encode_envelope(Envelope(node, boot, sequence, tick, 30, 300)))


def test_a_good_message_becomes_an_input() -> None:
    take, box = intake()
    assert take.take(arrival(5), 0) is None
    assert box.given == [Received(TOPIC, "sensors", "s1", 5, 30, MESSAGE)]


REFUSED = {
    "topic 'no/topic' is not in the topic table": arrival(topic="no/topic"),
    "r1/log/odometry is no topic that this node reads": arrival(topic="r1/log/odometry", node="log"),
    "topic '**' is not in the topic table": arrival(topic="**"),
    "unreadable envelope: Input data was truncated": Arrived(DATA + TOPIC, PAYLOAD, b""),
    "unreadable envelope: Expected `int` >= 0": Arrived(DATA + TOPIC, PAYLOAD, b"\x96\xa1a\xa1b\xff\x00\x00\x00"),
    "unreadable envelope: 'utf-8' codec": Arrived(DATA + TOPIC, PAYLOAD, b"\x96\xa2\xc2a\xa1b\x00\x00\x00\x00"),
    "unreadable envelope: 1000000 bytes; at most": Arrived(DATA + TOPIC, PAYLOAD, bytes(10**6)),
    "unknown sender 'vision'; expected sensors": arrival(node="vision"),
    "unknown sender 'estimator' with boot 's1'; this run's is None": arrival(
        topic="estimator/pose", node="estimator", boot="s1"
    ),
    "unknown sender 'sensors' with boot 'old'; this run's is 's1'": arrival(boot="old"),
    "unknown sender 'log' with boot 'c1'; this run's is 's1'": arrival(topic="log/odometry", node="log", boot="c1"),
    "controller/command is no topic that this node reads": arrival(
        topic="controller/command", node="controller", boot="c1"
    ),
    "sensors/odometry: a message of 16777217 bytes": arrival(payload=bytes(MOST_BYTES + 1)),
    "it comes in the name of 'sensors'; its key is that of 'vision'": arrival()._replace(key=f"{DATA}log/-/vision"),
    "it comes in the name of 'sensors'; its key is that of ''": arrival()._replace(key=f"{DATA}log"),
    "it comes in the name of 'sensors'; its key is that of 'x'": arrival()._replace(key=f"{DATA}{TOPIC}/-/x"),
    "sensors/odometry: Object missing required field `w`": arrival(payload=b'{"v":1}'),
    "sensors/odometry: Expected `float`, got `str` - at `$.v`": arrival(payload=b'{"v":"fast","w":0}'),
    "sensors/odometry: Object contains unknown field `x`": arrival(payload=b'{"v":1,"w":0,"x":0}'),
    "sensors/odometry: JSON is malformed": arrival(payload=b"?"),
    "sensors/odometry: 'utf-8' codec": arrival(payload=b'{"\xff":1}'),
    "tick 1; expected 0": arrival(tick=1),
    "sequence 4000000000 in tick 0; expected 0": arrival(4 * 10**9),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_bad_messages_are_refused_with_the_reason_and_then_a_good_one_is_accepted(reason: str) -> None:
    take, box = intake()
    refusal = take.take(REFUSED[reason], 0)
    assert refusal is not None
    assert str(refusal.error).startswith(reason)
    assert box.given == []
    assert take.take(arrival(), 0) is None  # a content that was refused does not hold its place
    assert isinstance(take.take(arrival(), 0), Refusal)  # a good one does
    assert len(box.given) == 1


def test_log_records_carry_the_boot_of_the_source_and_come_only_from_a_log_that_is_played() -> None:
    record = arrival(topic="log/odometry", node="log", boot="s1")
    assert Roles(PLAN, BOOTS).message(record)[:2] == ("log/odometry", "sensors")
    with pytest.raises(ProtocolError, match="not in the topic table"):
        Roles(BY_CLOCK, BOOTS).message(record)


DONE = TickDone("sensors", "s1", 3, 3, 30, {TOPIC: 1, "event/sensors": 1}, False)


def told(**changes: object) -> Arrived:
    done = {name: getattr(DONE, name) for name in DONE.__struct_fields__} | changes
    return Arrived(f"{TICK}sensors", encode_control(TickDone(**done)), b"")


@pytest.mark.parametrize(
    ("arrived", "reason"),
    [
        (told(boot="old"), "unknown sender 'sensors' with boot 'old'"),
        (told(node="controller", boot="c1"), "it comes in the name of 'controller'"),
        (told()._replace(key=f"{TICK}vision"), "it comes in the name of 'sensors'"),
        (told(step=4), "step 4 at tick 3"),
        (told(stamp_ns=40), "tick 3 at 40 ns; expected 30 ns"),
        (told(counts={"estimator/pose": 1}), "sensors promises messages on 'estimator/pose', which it does not write"),
        (told(counts={"log/odometry": 1}), "sensors promises messages on 'log/odometry', which it does not write"),
        (told(counts={"log": 1}), "sensors promises messages on 'log', which it does not write"),
        (told(counts={TOPIC: 10**9}), f"TickDone: 1000000000 messages on {TOPIC}; expected 1 to {MOST_OF_A_TICK}"),
        (told(counts={TOPIC: 0}), "TickDone: 0 messages"),
        (told(tick=2**63, step=2**63), "TickDone: Expected `int` <= 9223372036854775807"),
        (told()._replace(payload=bytes(10**6)), "TickDone: 1000000 bytes; at most"),
        (told()._replace(payload=b"\xff"), "TickDone: "),
    ],
)
def test_an_end_of_a_tick_counts_only_from_its_node_with_what_that_may_send(arrived: Arrived, reason: str) -> None:
    roles = Roles(BY_CLOCK, BOOTS)
    assert roles.tick(told()) == DONE
    with pytest.raises(ProtocolError) as refused:
        roles.tick(arrived)
    assert str(refused.value).startswith(reason)


def test_each_kind_of_refusal_is_told_of_at_a_bounded_rate_and_all_are_counted() -> None:
    refusals = Refusals(known_names(PLAN))
    lines = []
    for number in range(50_000):
        lines.append(refusals.note(f"{DATA}no/{number}", BadMessageError(f"reason {number}"), number))
        lines.append(refusals.note(DATA + TOPIC, UnknownSenderError(f"\x1b {number}"), number))
    assert [line for line in lines if line is not None] == [
        "no/0: message refused: reason 0",
        "sensors/odometry: message refused: \\x1b 0",
    ]
    assert refusals.note(f"{DATA}no/x", BadMessageError("later"), AGAIN_NS) == (
        "no/x: message refused: later (the last of 50000 alike)"
    )
    assert refusals.rest() == ["sensors/odometry: message refused: \\x1b 49999 (the last of 49999 alike)"]
    assert refusals.rest() == []
    assert refusals.counts == {"other keys": 50_001, TOPIC: 50_000}


@settings(derandomize=True, deadline=None, max_examples=300)
@given(payload=st.binary(max_size=40), attachment=st.binary(max_size=40), key=st.text(max_size=10))
def test_no_bytes_whatever_get_past_or_stop_it(payload: bytes, attachment: bytes, key: str) -> None:
    take, box = intake()
    good = arrival()
    for arrived in (
        Arrived(good.key, payload, attachment),
        Arrived(good.key, payload, good.attachment),
        Arrived(DATA + key, payload, good.attachment),
        Arrived(TICK + "sensors", payload, b""),
    ):
        assert isinstance(take.take(arrived, 0), Refusal)
    assert box.given == []
    assert take.take(arrival(), 0) is None


def test_what_a_sender_may_have_held_for_a_step_is_bounded() -> None:
    taking, box = intake()
    large = PAYLOAD + b" " * (MOST_BYTES_OF_A_TICK // 8)
    refusals = [taking.take(arrival(sequence, payload=large), 0) for sequence in range(1, 9)]
    assert refusals[:7] == [None] * 7
    assert refusals[7] is not None
    assert "bytes; at most" in str(refusals[7].error)
    assert taking.take(arrival(0), 0) is None, "there is room for what the step waits for"
    assert [one.sequence for one in box.given] == [*range(1, 8), 0]
