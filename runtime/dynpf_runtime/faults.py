"""Injected faults: a seeded link that loses and delays messages on their way to one node."""

from collections.abc import Iterable
from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf.rng import generator

__all__ = ["Fault", "FaultyLink"]

NonNegative = Annotated[float, Meta(ge=0.0)]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What befalls a topic on its way to node ``to``: each message is lost with probability ``loss``, else it is late
    by ``delay_s`` plus a uniform share of ``jitter_s``."""

    topic: str
    to: str
    loss: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    delay_s: NonNegative = 0.0
    jitter_s: NonNegative = 0.0


class FaultyLink:
    """The faults on the way to ``node``. The fate of a message depends on seed, topic and sequence alone."""

    def __init__(self, faults: Iterable[Fault], node: str, seed: int) -> None:
        self._faults = {fault.topic: fault for fault in faults if fault.to == node}
        self._node = node
        self._seed = seed
        self.faulty = bool(self._faults)

    def delay_ns(self, topic: str, sequence: int) -> int | None:
        """Return by how many nanoseconds the message is late, or None if it is lost."""
        fault = self._faults.get(topic)
        if fault is None:
            return 0
        lost, late = generator(self._seed, f"link/{self._node}", sequence, topic).random(2)
        if lost < fault.loss:
            return None
        return round((fault.delay_s + fault.jitter_s * float(late)) * 1e9)
