from collections.abc import Sequence

import pytest
from dynpf_protocol.codec import encode
from dynpf_protocol.messages import Odometry, RobotState
from dynpf_runtime.source import Feed, LogRecord, feed_log, feed_ticks
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode, graph_of

ODOMETRY, TRUTH = "log/odometry", "log/truth"


def record(topic: str, stamp_ns: int) -> LogRecord:
    message = Odometry(v=0.1, w=0.0) if topic == ODOMETRY else RobotState(x=0.0, y=0.0, theta=0.0)
    return LogRecord(topic, stamp_ns, encode(topic, message))


def feeds(letters: str, max_ticks: int = 1000, reads: frozenset[str] = frozenset({ODOMETRY})) -> list[Feed]:
    """Return the ticks of a log of o(dometry) and t(ruth), stamped 0, 1, ..."""
    records = [record({"o": ODOMETRY, "t": TRUTH}[letter], stamp) for stamp, letter in enumerate(letters)]
    graph = graph_of([ToyNode("sensors", reads=reads)])
    return list(feed_log(records, graph, boot="b", publish_ns=9, max_ticks=max_ticks))


def shape(ticks: Sequence[Feed]) -> list[str]:
    """Return the letters of each tick, with a full stop at the last."""
    return ["".join(one.topic[4] for one in tick.sent) + "." * tick.last for tick in ticks]


@pytest.mark.parametrize(
    ("log", "ticks"),
    [
        ("ooo", ["o", "o", "o."]),
        ("tototto", ["to", "to", "tto."]),
        ("ott", ["ott."]),
        ("otott", ["o", "tott."]),
        ("", []),
        ("tt", []),
    ],
)
def test_each_sensor_record_is_a_tick_and_the_others_ride_along(log: str, ticks: list[str]) -> None:
    assert shape(feeds(log)) == ticks


@pytest.mark.parametrize(
    ("log", "max_ticks", "ticks"),
    [("ooo", 2, ["o", "o."]), ("toto", 1, ["to."]), ("ototo", 3, ["o", "to", "to."]), ("otott", 2, ["o", "tott."])],
)
def test_the_limit_of_ticks_ends_the_log(log: str, max_ticks: int, ticks: list[str]) -> None:
    assert shape(feeds(log, max_ticks)) == ticks


def test_a_tick_has_the_time_of_its_sensor_record_and_envelopes_in_sequence() -> None:
    ticks = feeds("tototo")
    assert [tick.stamp_ns for tick in ticks] == [1, 3, 5]
    envelopes = [(one.topic, one.envelope) for tick in ticks for one in tick.sent]
    assert {(one.node, one.boot, one.publish_ns) for _, one in envelopes} == {("log", "b", 9)}
    assert [(topic, one.sequence, one.tick, one.stamp_ns) for topic, one in envelopes] == [
        (topic, tick, tick, 2 * tick + place) for tick in range(3) for place, topic in enumerate((TRUTH, ODOMETRY))
    ]


def test_the_node_is_given_only_what_it_reads() -> None:
    (tick,) = feeds("to")
    assert [(one.topic, one.node, one.sequence, one.stamp_ns) for one in tick.inputs] == [(ODOMETRY, "log", 0, 1)]
    assert tick.inputs[0].message == Odometry(v=0.1, w=0.0)
    (tick,) = feeds("to", reads=frozenset({ODOMETRY, TRUTH}))
    assert [one.topic for one in tick.inputs] == [TRUTH, ODOMETRY]


@settings(derandomize=True, deadline=None, max_examples=100)
@given(log=st.text("ot", max_size=12), max_ticks=st.integers(1, 15))
def test_nothing_is_lost_doubled_or_swapped_and_only_the_last_tick_says_so(log: str, max_ticks: int) -> None:
    ticks = shape(feeds(log, max_ticks))
    assert len(ticks) == min(log.count("o"), max_ticks)
    assert [tick.endswith(".") for tick in ticks] == [place + 1 == len(ticks) for place in range(len(ticks))]
    fed = "".join(ticks).replace(".", "")
    assert log.startswith(fed)
    if 0 < log.count("o") <= max_ticks:
        assert fed == log


def test_a_simulators_ticks_are_equal_and_end_at_the_limit() -> None:
    ticks = list(feed_ticks(50, 3))
    assert [(tick.stamp_ns, tick.last) for tick in ticks] == [(0, False), (50, False), (100, True)]
    assert not any(tick.sent or tick.inputs for tick in ticks)
