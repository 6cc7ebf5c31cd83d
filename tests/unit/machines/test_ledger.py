"""The ledger of a recorder: what belongs to a step, by its end and its journal entry, whatever else comes."""

from collections.abc import Iterable

import pytest
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError, TooLargeError
from dynpf_protocol.journal import JournalEntry, Produced, encode_entry
from dynpf_runtime.machines.effects import Record
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.roles import MOST_BYTES_OF_A_TICK, Roles
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode, graph_of

TOPIC, RARE = "sensors/odometry", "sensors/landmarks"
GRAPH = graph_of([ToyNode("sensors", writes=[TOPIC, RARE, "log"])])
PLAN = plan_of(load_scenario("landmark-room"))._replace(graph=GRAPH)
TICKS = 6
GOOD, OTHER, BAD = b'{"v":1.0,"w":0.0}', b'{"v":2.0,"w":0.0}', b"?"

Said = tuple[str, Envelope, bytes] | TickDone | JournalEntry
"""A message, an end of a tick or a journal entry."""


def ledger() -> Ledger:
    return Ledger(PLAN, Roles(PLAN, {"sensors": "s1"}))


def message(sequence: int, tick: int, payload: bytes = GOOD, topic: str = TOPIC) -> Said:
    return topic, Envelope("sensors", "s1", sequence, tick, tick, 0), payload


def end(tick: int, count: int = 1, *, last: bool = False) -> TickDone:
    return TickDone("sensors", "s1", tick, tick, tick, {TOPIC: count} if count else {}, last)


def entry(step: int, made: Iterable[int], *, last: bool = False, state: str = "") -> JournalEntry:
    produced = tuple(Produced(TOPIC, sequence) for sequence in made)
    return JournalEntry(step=step, tick=step, stamp_ns=step, consumed=(), produced=produced, last=last, state=state)


def step(number: int) -> list[Said]:
    last = number + 1 == TICKS
    return [message(number, number), end(number, last=last), entry(number, [number], last=last)]


TRUE: list[Said] = [said for number in range(TICKS) for said in step(number)]


def taken(book: Ledger, said: Iterable[Said]) -> list[Record]:
    records: list[Record] = []
    for one in said:
        try:
            match one:
                case TickDone():
                    records += book.end(one)
                case JournalEntry():
                    records += book.entry(
                        Envelope("sensors", "s1", one.step, one.tick, one.tick, 0), one, encode_entry(one)
                    )
                case (name, envelope, payload):
                    records += book.message(name, "sensors", envelope, payload)
        except OrderError:
            continue
    return records


WHOLE = taken(ledger(), TRUE)


def test_on_a_shared_topic_a_host_may_speak_between_the_messages_of_its_node() -> None:
    """They have one count: what the host says of a refusal takes the number that the node's next message would have."""
    book = ledger()
    roles = Roles(PLAN, {"sensors": "s1"})
    said = step(0)
    said += [message(0, 1, b"of the host", "log"), message(1, 1), message(1, 1, b"of the node", "log")]
    done = TickDone("sensors", "s1", 1, 1, 1, {TOPIC: 1, "log": 1}, False)
    made = entry(1, [1])
    produced = (*made.produced, Produced("log", 1))
    said += [done, JournalEntry(step=1, tick=1, stamp_ns=1, consumed=(), produced=produced), *step(2)]
    assert len(taken(book, said)) == 3 * 2 + 2
    assert (book.ticks, book.missing(), book.doubt) == (3, {}, "")
    assert not roles.promised("log", "sensors") and roles.promised(TOPIC, "sensors")


def test_a_run_is_written_step_by_step() -> None:
    book = ledger()
    assert [len(taken(book, [one])) for one in TRUE] == [0, 0, 2] * TICKS
    assert (book.ended, book.ending, book.ticks, book.missing(), book.doubt) == (True, True, TICKS, {}, "")


HARMLESS: dict[str, list[Said]] = {
    "ahead": [message(5, 2), message(10**6, 2), message(3, 10**6), message(4, 4)],
    "one more": [message(3, 2), message(0, 2, topic=RARE)],
    "again": TRUE[:6],
    "late": [message(0, 0, OTHER), message(1, 1, BAD)],
    "late end": [end(0, 0), end(0, last=True)],
    "late entry": [entry(0, []), entry(1, [1], state="x")],
    "future ends": [end(tick, 0) for tick in range(4, 40)],
    "future last": [end(tick, last=True) for tick in range(4, 40)],
    "future entries": [entry(tick, [], last=True) for tick in range(4, 40)],
    "unreadable": [message(2, 2, BAD)],
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_cannot_be_true_changes_nothing(name: str) -> None:
    book = ledger()
    assert taken(book, [*TRUE[:6], *HARMLESS[name], *TRUE[6:]]) == WHOLE
    assert (book.ended, book.missing(), book.doubt) == (True, {}, "")


FORGED: dict[str, list[Said]] = {
    "message": [message(2, 2, OTHER)],
    "end": [end(2, 0)],
    "last end": [end(2, last=True)],
    "large end": [end(2, 1000)],
    "entry": [entry(2, [])],
    "whole step": [message(2, 2, OTHER), end(2), entry(2, [2])],
    "whole other step": [end(2, 0), entry(2, [])],
    "all to come": [said for number in range(2, TICKS) for said in (message(number, number, OTHER), *step(number)[1:])],
}


@pytest.mark.parametrize("name", FORGED)
def test_who_was_faster_than_the_true_one_makes_the_run_doubtful(name: str) -> None:
    book = ledger()
    taken(book, [*TRUE[:6], *FORGED[name], *TRUE[6:]])
    assert book.doubt
    assert "of sensors" in book.doubt


@settings(derandomize=True, deadline=None, max_examples=300)
@given(data=st.data())
def test_no_order_of_forgeries_gives_another_whole_run_without_doubt(data: st.DataObject) -> None:
    place = st.integers(0, TICKS)
    forgery = st.one_of(
        st.builds(message, place, place, st.sampled_from([GOOD, OTHER, BAD])),
        st.builds(end, place, st.integers(0, 3), last=st.booleans()),
        st.builds(entry, place, st.lists(place, max_size=2), last=st.booleans()),
    )
    said: list[Said] = []
    for one in TRUE:
        said += [*data.draw(st.lists(forgery, max_size=2)), one]
    book = ledger()
    records = taken(book, said)
    if not book.doubt and book.ended and not book.missing():
        assert records == WHOLE


def test_what_is_lost_is_missing_and_the_rest_is_kept() -> None:
    for index, lost in enumerate(TRUE[:-3]):
        book = ledger()
        records = taken(book, TRUE[:index] + TRUE[index + 1 :])
        records += book.rest()
        kept = [record for record in WHOLE if record in records]
        assert len(kept) == len(WHOLE) - (not isinstance(lost, TickDone))
        assert sum(book.missing().values()) == (not isinstance(lost, TickDone))


def test_the_messages_of_a_step_take_a_bounded_memory() -> None:
    book, large = ledger(), GOOD + b" " * (MOST_BYTES_OF_A_TICK // 8)
    taken(book, [message(number + 1, 0, large) for number in range(7)])
    with pytest.raises(TooLargeError, match="bytes in one tick already"):
        taken_strictly(book, message(8, 0, large))
    taken_strictly(book, message(0, 0))
    assert [record.envelope.sequence for record in taken(book, [end(0), entry(0, [0])])] == [0, 0]


def taken_strictly(book: Ledger, said: Said) -> None:
    name, envelope, payload = said  # type: ignore[misc]
    book.message(name, "sensors", envelope, payload)


def test_a_tick_that_others_read_in_the_next_one_is_kept_when_that_is_written() -> None:
    """The source begins a tick when the last node has ended the one before; that node reads the source at once."""
    graph = graph_of([ToyNode("simulator", writes=["truth/robot"]), ToyNode("sensors", reads=["truth/robot"])])
    plan = PLAN._replace(graph=graph)
    book = Ledger(plan, Roles(plan, dict.fromkeys(graph.nodes, "s1")))
    assert book.kept() == {"simulator": 0, "sensors": 0}
    for tick in range(3):
        for name in graph.nodes:
            made = entry(tick, ())
            list(book.end(TickDone(name, "s1", tick, tick, tick, {}, False)))
            list(book.entry(Envelope(name, "s1", tick, tick, tick, 0), made, encode_entry(made)))
        assert book.kept() == {"simulator": tick + 1, "sensors": tick}
