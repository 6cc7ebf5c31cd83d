"""Injected faults: a seeded link that loses and delays messages on their way to one node."""

from collections.abc import Iterable

import msgspec

from dynpf.rng import generator
from dynpf.types import NonNegative, Share

__all__ = ["Fault", "FaultyLink"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Loss and delay of a topic's messages to node ``to``: each is lost with probability ``loss``, else delayed by
    ``delay_s`` plus a uniformly distributed part of ``jitter_s``."""

    topic: str
    to: str
    loss: Share = 0.0
    delay_s: NonNegative = 0.0
    jitter_s: NonNegative = 0.0


class FaultyLink:
    """The faults of all topics to ``node``. A message's loss and delay depend only on seed, topic and sequence."""

    def __init__(self, faults: Iterable[Fault], node: str, seed: int) -> None:
        self._faults = {fault.topic: fault for fault in faults if fault.to == node}
        self._node = node
        self._seed = seed
        self.faulty = bool(self._faults)

    def delay_ns(self, topic: str, sequence: int) -> int | None:
        """Return the delay of a message in nanoseconds, or None if it is lost."""
        fault = self._faults.get(topic)
        if fault is None:
            return 0
        lost, late = generator(self._seed, f"link/{self._node}", sequence, topic).random(2)
        if lost < fault.loss:
            return None
        return round((fault.delay_s + fault.jitter_s * float(late)) * 1e9)
