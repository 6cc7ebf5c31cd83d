"""What has no room in the recorder's queue is noted where it would have been."""

from dynpf_formats.capture.form import Dropped
from dynpf_formats.ros2.attachment import Attachment
from dynpf_services.ros2.arrivals import Arrivals
from dynpf_services.ros2.hearing import Drops

ONE, OTHER = b"1" * 16, b"2" * 16


def dropped(number: int, publisher: bytes = ONE) -> Dropped:
    return Dropped.of("k", Attachment(number, number, publisher), number)


def test_a_full_queue_notes_what_it_refuses_between_what_it_has():
    arrivals: Arrivals[str] = Arrivals(most=10, largest=6)
    assert arrivals.put("a", 6)
    assert not arrivals.put("b", 6, lambda last: f"lost after {last}")
    assert not arrivals.put("c", 6, lambda _: None)
    assert arrivals.put("d", 4)
    assert not arrivals.put("too large", 7, lambda _: "also")
    assert [arrivals.take() for _ in range(5)] == ["a", "lost after a", "d", "also", None]
    assert not arrivals.put("too large", 7, lambda last: f"lost after {last}")  # nothing waits
    assert arrivals.take() == "lost after None"
    assert arrivals.put("e", 6)


def test_messages_dropped_one_after_another_are_one_range_for_each_publisher():
    drops = Drops()
    for one in [dropped(1), dropped(7, OTHER), dropped(2), dropped(8, OTHER), dropped(5), dropped(6)]:
        drops.add(one)
    assert [(one.publisher, one.first, one.last, one.count) for one in drops.dropped] == [
        (ONE.hex(), 1, 2, 2),
        (OTHER.hex(), 7, 8, 2),
        (ONE.hex(), 5, 6, 2),
    ]
