"""Arrivals: the queue of all that a process receives, which takes a bounded memory whatever is sent to the process."""

import threading
from queue import Empty, SimpleQueue

from dynpf_runtime.machines.events import Arrived, Dropped, Token

__all__ = ["MOST_QUEUED", "Arrivals"]

MOST_QUEUED = 128 * 2**20
"""How much may wait in the queue, bytes. One key may take half of it: no message is larger, and no run is so late."""

_EACH = 300
"""What an item takes besides its content, bytes."""

_MOST_TOKENS = 100_000
"""How many tokens may wait: more than the processes of any run have."""


class Arrivals:
    """A queue that drops, and counts, what does not fit into ``most`` bytes; any thread may offer.

    What waits under one key takes at most as much as is free. So a flood under one key leaves half of the queue to all
    others, and one under two keys a third.
    """

    def __init__(self, most: int = MOST_QUEUED) -> None:
        self._queue: SimpleQueue[Arrived | Token | Dropped | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._free = most
        self._held: dict[str, int] = {}  # key -> bytes that wait under it
        self._tokens = 0
        self._dropped = 0  # since the last word of it was taken from the queue

    def offer(self, arrived: Arrived) -> None:
        """Add a message if it fits."""
        size = _size(arrived)
        with self._lock:
            held = self._held.get(arrived.key, 0) + size
            if held <= self._free - size:
                self._held[arrived.key] = held
                self._free -= size
                self._queue.put(arrived)
            else:
                self._drop(arrived.key)

    def offer_token(self, token: Token) -> None:
        """Add the word that a token has appeared or disappeared."""
        with self._lock:
            if self._tokens < _MOST_TOKENS:
                self._tokens += 1
                self._queue.put(token)
            else:
                self._drop(token.key)

    def wake(self) -> None:
        """Make a waiting ``take`` return None; may be called from a signal handler."""
        self._queue.put(None)

    def take(self, timeout_s: float) -> Arrived | Token | Dropped | None:
        """Return the next item, or None after ``timeout_s`` or when woken."""
        try:
            item = self._queue.get(timeout=timeout_s) if timeout_s > 0 else self._queue.get_nowait()
        except Empty:
            return None
        if item is None:
            return None
        with self._lock:
            if type(item) is Arrived:
                self._release(item)
            elif type(item) is Token:
                self._tokens -= 1
            elif type(item) is Dropped:
                item, self._dropped = item._replace(messages=self._dropped), 0
        return item

    def __len__(self) -> int:
        return self._queue.qsize()

    def _release(self, arrived: Arrived) -> None:
        size = _size(arrived)
        self._free += size
        left = self._held[arrived.key] - size
        if left:
            self._held[arrived.key] = left
        else:
            del self._held[arrived.key]

    def _drop(self, key: str) -> None:
        """Count what is dropped; one item of the queue tells of it, with the key of the first."""
        self._dropped += 1
        if self._dropped == 1:
            self._queue.put(Dropped(key, 1))


def _size(arrived: Arrived) -> int:
    return _EACH + len(arrived.key) + len(arrived.payload) + len(arrived.attachment)
