"""Offers: the snapshots that nodes offer to the recorder, and which of them counts.

A snapshot is what a peer says: it counts if it has the state and the chain value of the journal of its step, and only
once all steps up to its own are in the file, because a node does not say again what is before it.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.restoring import agreed, decode_snapshot
from dynpf_protocol.snapshots import FrozenInbox

__all__ = ["Offer", "Offers"]

_MOST_OFFERED = 4
"""How many snapshots of a node are kept that do not count yet."""


class Offer(NamedTuple):
    """A snapshot, its message, and the inbox in it, which is known once it has been compared with the journal."""

    snapshot: Snapshot
    payload: bytes
    inbox: FrozenInbox | None = None


class Offers:
    """The snapshots of the nodes ``names``."""

    def __init__(self, names: Iterable[str]) -> None:
        self.counting: dict[str, Offer] = {}  # the last that counts, of each node
        self._waiting: dict[str, deque[Offer]] = {name: deque(maxlen=_MOST_OFFERED) for name in names}

    def last(self, name: str) -> int:
        """Return the tick of a node's snapshot that counts, -1 if there is none."""
        counting = self.counting.get(name)
        return -1 if counting is None else counting.snapshot.tick

    def take(self, name: str, payload: bytes) -> Snapshot | None:
        """Take a node's snapshot, before or after its step is written; None if it cannot be read."""
        try:
            offer = Offer(decode_snapshot(payload), payload)
        except BadMessageError:
            return None
        self._waiting[name].append(offer)
        return offer.snapshot

    def wrote(self, name: str, tick: int, entry: JournalEntry | None) -> None:
        """Keep the snapshots of a written step only if they are of the state that its entry has.

        ``entry`` is None if it has no digest of the state.
        """
        waiting = self._waiting[name]
        for offer in [one for one in waiting if one.snapshot.tick == tick]:
            waiting.remove(offer)
            try:
                frozen = agreed(offer.snapshot, entry)
            except BadMessageError:
                continue
            waiting.append(offer._replace(inbox=frozen.inbox))

    def confirm(self, kept: Mapping[str, int]) -> bool:
        """Let the snapshots count whose nodes have so many ticks in the file; return whether others count now."""
        changed = False
        for name, waiting in self._waiting.items():
            counting = [one for one in waiting if one.inbox is not None and one.snapshot.tick < kept.get(name, 0)]
            if counting:
                self.counting[name], changed = counting[-1], True
                last = counting[-1].snapshot.tick
                self._waiting[name] = deque((one for one in waiting if one.snapshot.tick > last), _MOST_OFFERED)
        return changed
