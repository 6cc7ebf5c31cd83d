"""What a node's new start does again in realtime, by the pieces that the recorder gives it."""

import pytest
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import RunError
from dynpf_protocol.journal import Consumed, Hosted, JournalEntry, Produced, encode_entry
from dynpf_protocol.keys import JOURNAL, data_key
from dynpf_protocol.messages import HostEvent, Message, Odometry
from dynpf_protocol.recall import Piece
from dynpf_runtime.gaps import GapWatch
from dynpf_runtime.machines.repeating import Again, Repeating

ODOMETRY, EVENT = "sensors/odometry", "event/estimator"


def message(topic: str, node: str, sequence: int, content: Message) -> Piece:
    envelope = Envelope(node, "b", sequence, 0, 10 * sequence, 0)
    return Piece(data_key(topic, node), encode(topic, content), encode_envelope(envelope))


def odometry(sequence: int) -> Piece:
    return message(ODOMETRY, "sensors", sequence, Odometry(v=float(sequence), w=0.0))


def gap(sequence: int, first: int) -> Piece:
    event = HostEvent(kind="gap", topic=ODOMETRY, node="sensors", first=first, last=first)
    return message(EVENT, "estimator", sequence, event)


def entered(*, last: bool = False) -> Piece:
    """Return the entry of a step that has read odometry 4 after a gap, and reported one of a robot's, too."""
    entry = JournalEntry(
        step=7,
        tick=7,
        stamp_ns=40,
        consumed=(Consumed("sensors", "b", ODOMETRY, 4), Consumed("estimator", "b", EVENT, 2)),
        produced=(Produced("estimator/state", 7), Produced("log", 5), Produced("log", 6)),
        hosted=(Hosted("estimator", EVENT, 2), Hosted("estimator", EVENT, 3)),
        last=last,
    )
    return Piece(JOURNAL + "estimator", encode_entry(entry), b"")


def taken(repeating: Repeating, *pieces: Piece) -> list[Again | None]:
    watch = GapWatch()
    watch.see(ODOMETRY, "sensors", 0)
    return [repeating.take(piece, watch) for piece in pieces]


def test_a_step_reads_again_what_the_journal_says_and_its_host_finds_the_gaps_again() -> None:
    repeating = Repeating("estimator", known_topics())
    *before, again = taken(repeating, odometry(4), gap(2, 1), gap(3, 99), entered(last=True))
    assert before == [None] * 3
    assert again is not None
    ((tick, stamp_ns, (read,), last), due_ns, ends, fed, of_robot) = again.turn
    assert (tick, stamp_ns, last, due_ns, ends, fed) == (7, 40, True, 40, True, ())
    assert (read.topic, read.sequence, read.stamp_ns, read.message) == (ODOMETRY, 4, 40, Odometry(v=4.0, w=0.0))
    assert [event.first for event in of_robot] == [99]  # the other follows from what is read
    assert again.numbers == {"log": 5}  # its host may have said some in between


def test_an_answer_that_lacks_what_a_step_has_read_is_refused() -> None:
    with pytest.raises(RunError, match="estimator cannot come back: the recorder's answer is wrong"):
        taken(Repeating("estimator", known_topics()), gap(2, 1), gap(3, 99), entered())
    with pytest.raises(RunError, match="estimator cannot come back"):
        taken(Repeating("estimator", known_topics()), Piece(JOURNAL + "estimator", b"{}", b""))
