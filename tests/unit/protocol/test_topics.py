"""The topic tables are whole: every row names known nodes, says what it is for, and has a type with a schema."""

import pytest
from dynpf_formats.shipped import known_topics, listed, load
from dynpf_protocol.errors import UnknownTopicError
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.keys import OPERATOR, SHARED
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import HOST_NODES, LOG_NODE, NODES, Delivery, Topic, is_record, topic
from dynpf_protocol.topics import TOPICS as TOPICS_OF_ANY
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.protocol.built_messages import plainest

TOPICS = known_topics()

rows = pytest.mark.parametrize("row", TOPICS.values(), ids=TOPICS)


@rows
def test_a_row_is_whole(row: Topic) -> None:
    assert topic(row.name, TOPICS) is row
    assert row.publishers
    assert set(row.publishers) <= {*HOST_NODES, "recorder", OPERATOR}
    assert row.description[:1].isupper()
    assert not row.description.endswith(".")
    assert isinstance(row.delivery, Delivery)


@rows
def test_a_name_stands_for_one_topic_everywhere_it_is_used(row: Topic) -> None:
    assert all(part.replace("_", "").isalnum() and part.islower() for part in row.name.split("/"))
    assert not row.name.startswith(JOURNAL_PREFIX)
    # Its publisher's name comes first, so that one cannot take another's topics; hosts and pictures stand apart.
    first = row.name.partition("/")[0]
    assert first in {*row.publishers, "event", "snapshot", *SHARED} or row.publishers == ("simulator",)


@rows
def test_a_type_has_a_schema_of_ours_or_of_foxglove(row: Topic) -> None:
    assert issubclass(row.type, Message)
    maker, _, name = row.type.schema_name.partition(".")
    assert maker in {"dynpf", "foxglove"}
    assert name == row.type.__name__
    assert type(plainest(row.type)) is row.type


def test_no_table_has_a_topic_of_another() -> None:
    tables = [TOPICS_OF_ANY, *({row.name: row for row in load(topics)} for topics in listed("TOPICS"))]
    assert sum(map(len, tables)) == len(TOPICS)
    assert len(TOPICS_OF_ANY) < len(TOPICS)


def test_two_types_never_share_a_schema_name() -> None:
    kinds = {row.type for row in TOPICS.values()}
    assert len({kind.schema_name for kind in kinds}) == len(kinds)


def test_what_is_told_by_the_wall_clock_or_by_a_host_is_never_compared() -> None:
    assert {name for name, row in TOPICS.items() if not row.compared} == {
        "diagnostics",
        "log",
        "notice",
        "recorder/gap",
        "recorder/restart",
        *(f"{kind}/{node}" for node in NODES for kind in ("event", "snapshot")),
    }


def test_every_node_hears_of_its_missing_inputs() -> None:
    assert all(TOPICS[f"event/{node}"].publishers == (node,) for node in NODES)


def test_every_nodes_state_is_told_by_its_own_host() -> None:
    assert all(TOPICS[f"snapshot/{node}"].publishers == (node,) for node in NODES)


def test_only_of_large_and_frequent_topics_may_a_node_pass_over_old_messages() -> None:
    assert {name for name, row in TOPICS.items() if row.delivery is Delivery.FRESH} == {"camera/image", "sensors/scan"}


def test_what_is_told_by_a_host_or_is_there_to_be_looked_at_wakes_nobody() -> None:
    pictures = {row.name for row in TOPICS.values() if row.type.schema_name.startswith("foxglove.")}
    idle = {name for name, row in TOPICS.items() if not row.wakes}
    assert pictures - {"camera/image", "log/scan", "sensors/scan"} <= idle
    assert {name for name, row in TOPICS.items() if not row.compared} <= idle


def test_of_an_imported_log_all_but_poses_of_others_and_what_the_scanner_says_begins_a_tick() -> None:
    log = {row.name: row.wakes for row in TOPICS.values() if row.publishers == (LOG_NODE,)}
    assert log.pop("log/truth") is log.pop("log/localized") is log.pop("log/scanner") is False
    assert log
    assert all(log.values())


@given(st.sampled_from([*TOPICS, "no/topic"]), st.sampled_from(["", "r1/", "a/b/", "r1", "catalog/"]))
def test_the_records_of_a_log_are_those_of_the_table_for_any_robot(name: str, robot: str) -> None:
    try:
        expected = topic(robot + name).publishers == (LOG_NODE,)
    except UnknownTopicError:
        expected = False
    assert is_record(robot + name) == expected
