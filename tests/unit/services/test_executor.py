import math

import pytest
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError, StepError
from dynpf_protocol.journal import Consumed, JournalEntry, Produced
from dynpf_protocol.messages import Command, Odometry
from dynpf_protocol.topics import TOPICS
from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.node import Output, Result, Step, state_digest
from msgspec import structs

from tests.unit.services.toy_nodes import IDLE, ToyNode, executor_of, received, says, spec_of


def advance(executor: Executor, tick: int, *, last: bool = False) -> tuple[tuple[Sent, ...], JournalEntry]:
    inputs = [received("sensors/odometry", "sensors", sequence) for sequence in (2 * tick, 2 * tick + 1)]
    sent = executor.step(tick, tick * 100, inputs, 5).sent
    return sent, executor.journal(tick, tick * 100, inputs, sent, last=last)


def test_each_topic_is_numbered_by_itself_and_the_journal_tells_all() -> None:
    node = ToyNode(
        "estimator",
        writes=["controller/command", "sensors/odometry"],
        act=lambda step: Result(
            (
                Output("controller/command", IDLE),
                Output("sensors/odometry", Odometry(v=step.tick * 1.0, w=0.0)),
                Output("controller/command", IDLE),
            )
        ),
    )
    executor = executor_of(node, "boot", digest_every=10)
    executor.stamp("sensors/odometry", Odometry(v=0.0, w=0.0), 0, 0, 0)  # the host's own message takes a number too
    advance(executor, 4)
    sent, entry = advance(executor, 6)
    assert [(one.topic, one.envelope.sequence) for one in sent] == [
        ("controller/command", 2),
        ("sensors/odometry", 2),
        ("controller/command", 3),
    ]
    envelope = sent[1].envelope
    assert (envelope.node, envelope.boot, envelope.tick, envelope.stamp_ns, envelope.publish_ns) == (
        "estimator",
        "boot",
        6,
        600,
        5,
    )
    assert decode("sensors/odometry", sent[1].payload) == Odometry(v=6.0, w=0.0)
    assert entry == JournalEntry(
        step=1,
        tick=6,
        stamp_ns=600,
        consumed=(Consumed("sensors", "b", "sensors/odometry", 12), Consumed("sensors", "b", "sensors/odometry", 13)),
        produced=(
            Produced("controller/command", 2),
            Produced("sensors/odometry", 2),
            Produced("controller/command", 3),
        ),
    )
    assert [(step.number, step.tick) for step in node.steps] == [(0, 4), (1, 6)]


def test_digests_are_taken_at_intervals_and_at_the_last_step() -> None:
    executor = executor_of(ToyNode("estimator"), "boot", digest_every=3)
    entries = [advance(executor, tick, last=tick == 7)[1] for tick in range(8)]
    assert [entry.step for entry in entries if entry.state] == [2, 5, 7]
    assert [entry.state for entry in entries if entry.state] == [state_digest({"steps": steps}) for steps in (3, 6, 8)]
    assert [entry.last for entry in entries] == [False] * 7 + [True]


def test_the_source_says_itself_when_it_has_finished() -> None:
    node = ToyNode("simulator", act=lambda step: Result(finished=step.tick == 1))
    executor = executor_of(node, "boot", digest_every=3)
    assert [executor.step(tick, 0, [], 0).finished for tick in range(2)] == [False, True]


@pytest.mark.parametrize(
    ("topic", "message", "told"),
    [
        ("estimator/state", IDLE, "BadMessageError: estimator/state: got Command, expected Estimate"),
        ("controller/command", Command(vx=math.nan), "BadMessageError: controller/command: Expected `fl"),
    ],
)
def test_what_a_topic_does_not_promise_is_refused(topic: str, message: Command, told: str) -> None:
    executor = executor_of(ToyNode("controller", writes=[topic], act=lambda _: says(topic, message)), "boot", 1)
    with pytest.raises(StepError, match=f"^controller failed in step 0, tick 3: {told}"):
        executor.step(3, 0, [], 0)


def test_a_topic_that_is_not_of_the_run_is_refused() -> None:
    node = ToyNode("controller", writes=["controller/command"], act=lambda _: says("controller/command", IDLE))
    executor = Executor(node, spec_of(node), {}, "boot", 1)
    told = "UnknownTopicError: topic 'controller/command' is not in the topic table"
    with pytest.raises(StepError, match=f"^controller failed in step 0, tick 3: {told}"):
        executor.step(3, 0, [], 0)


def test_a_node_has_its_own_names_for_topics_and_the_run_has_theirs() -> None:
    node = ToyNode("r1/estimator", act=lambda _: says("estimator/command", IDLE))
    row = structs.replace(TOPICS["controller/command"], name="r1/other/command")
    own = {"r1/sensors/odometry": "sensors/odometry"}
    spec = NodeSpec(node.name, "toy", lambda: node, own, {"estimator/command": row})
    executor = Executor(node, spec, {row.name: row}, "boot", 1)
    inputs = [received("r1/sensors/odometry", "r1/sensors", 0)]
    sent = executor.step(0, 0, inputs, 0).sent
    entry = executor.journal(0, 0, inputs, sent, last=True)
    assert [one.topic for one in node.steps[0].inputs] == ["sensors/odometry"]
    assert [(one.topic, one.envelope.node) for one in sent] == [("r1/other/command", "r1/estimator")]
    assert [one.topic for one in entry.consumed] == ["r1/sensors/odometry"]
    assert [one.topic for one in entry.produced] == ["r1/other/command"]


def test_a_message_for_a_topic_that_the_node_does_not_declare_is_refused() -> None:
    executor = executor_of(
        ToyNode("controller", writes=["log"], act=lambda _: says("controller/command", IDLE)), "boot", 1
    )
    told = "returned messages for controller/command, which it does not declare"
    with pytest.raises(StepError, match=f"^controller failed in step 0, tick 3: ValueError: {told}"):
        executor.step(3, 0, [], 0)


def test_a_message_that_a_host_may_not_send_takes_no_number() -> None:
    executor = executor_of(ToyNode("controller"), "boot", 1)
    with pytest.raises(BadMessageError):
        executor.stamp("estimator/state", IDLE, 0, 0, 0)
    executor.stamp("controller/command", IDLE, 0, 0, 0)
    with pytest.raises(BadMessageError):
        executor.stamp("controller/command", Odometry(v=0.0, w=0.0), 0, 0, 0)
    assert executor.stamp("controller/command", IDLE, 0, 0, 0).envelope.sequence == 1


def test_a_node_that_raises_is_named_with_its_step_and_the_place() -> None:
    def act(step: Step) -> Result:
        if step.number == 2:
            raise ZeroDivisionError("by nothing")
        return Result()

    executor = executor_of(ToyNode("estimator", act=act), "boot", 10)
    advance(executor, 5)
    advance(executor, 6)
    with pytest.raises(StepError) as told:
        advance(executor, 7)
    line = act.__code__.co_firstlineno + 2
    assert str(told.value) == (f"estimator failed in step 2, tick 7: ZeroDivisionError: by nothing ({__file__}:{line})")
    assert told.value.exit_code == 1
    assert isinstance(told.value.__cause__, ZeroDivisionError)  # its traceback is for whoever mends the node


def test_a_state_that_cannot_be_taken_out_is_the_nodes_fault() -> None:
    node = ToyNode("estimator")
    node.freeze = lambda: {"handle": object()}  # type: ignore[method-assign]
    with pytest.raises(StepError, match="estimator failed in step 0, tick 0: TypeError: a node's state holds a object"):
        advance(executor_of(node, "boot", 1), 0)
