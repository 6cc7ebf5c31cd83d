"""The queue of what a process receives: a flood takes a bounded memory, leaves room for others, and is counted."""

import pytest
from dynpf_runtime.bus.arrivals import Arrivals
from dynpf_runtime.machines.events import Arrived, Dropped, Token

MOST = 100_000


def message(key: str, size: int = 1000) -> Arrived:
    return Arrived(key, bytes(size), b"")


def taken(arrivals: Arrivals) -> list[Arrived | Token | Dropped | None]:
    return [arrivals.take(0.0) for _ in range(len(arrivals))]


@pytest.mark.parametrize("size", [0, 100, 5000])
def test_a_flood_under_one_key_takes_half_of_the_queue_and_leaves_the_rest_to_others(size: int) -> None:
    arrivals = Arrivals(MOST)
    for _ in range(10_000):
        arrivals.offer(message("flood", size))
    for number in range(10):
        arrivals.offer(message(f"quiet/{number}", 1000))
    items = taken(arrivals)
    assert [item.key for item in items if type(item) is Arrived][-10:] == [f"quiet/{number}" for number in range(10)]
    flood = [item for item in items if type(item) is Arrived and item.key == "flood"]
    assert 0.4 * MOST < len(flood) * (size + 305) <= 0.5 * MOST
    assert [item for item in items if type(item) is Dropped] == [Dropped("flood", 10_000 - len(flood))]


def test_what_is_taken_makes_room_again_and_every_message_is_taken_or_counted() -> None:
    arrivals = Arrivals(MOST)
    messages = dropped = 0
    for _ in range(20):
        for number in range(200):
            arrivals.offer(message(f"key/{number % 3}"))
        items = taken(arrivals)
        messages += sum(type(item) is Arrived for item in items)
        dropped += sum(item.messages for item in items if type(item) is Dropped)
        assert any(type(item) is Arrived for item in items)
    assert messages + dropped == 20 * 200
    assert dropped > 0


def test_nothing_is_dropped_of_what_fits() -> None:
    arrivals = Arrivals(MOST)
    sent = [message("key", 100) for _ in range(100)]
    for one in sent:
        arrivals.offer(one)
    arrivals.offer_token(Token("alive/x", present=True))
    assert taken(arrivals) == [*sent, Token("alive/x", present=True)]
    arrivals.wake()
    assert arrivals.take(0.0) is None
