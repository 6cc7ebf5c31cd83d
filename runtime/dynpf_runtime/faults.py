"""Injected faults: a seeded link that loses and delays messages on their way to one node."""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from dynpf.rng import generator
from dynpf.types import NonNegative, Share

__all__ = ["Fault", "FaultyLink", "LeftOut"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Loss and delay of a topic's messages to node ``to``: each is lost with probability ``loss``, else delayed by
    ``delay_s`` plus a uniformly distributed part of ``jitter_s``."""

    topic: str
    to: str
    loss: Share = 0.0
    delay_s: NonNegative = 0.0
    jitter_s: NonNegative = 0.0


class LeftOut(NamedTuple):
    """Messages of a topic that do not reach node ``to``: those with a stamp from ``first_ns`` to before ``end_ns``."""

    topic: str
    to: str
    first_ns: int
    end_ns: int


class FaultyLink:
    """The faults of all topics to ``node``. A message's loss and delay depend only on seed, topic, sequence and stamp.

    Messages that are ``left_out`` are lost, too.
    """

    def __init__(self, faults: Iterable[Fault], node: str, seed: int, left_out: Iterable[LeftOut] = ()) -> None:
        self._faults = {fault.topic: fault for fault in faults if fault.to == node}
        self._left_out = [each for each in left_out if each.to == node]
        self._node = node
        self._seed = seed
        self.faulty = bool(self._faults or self._left_out)

    def delay_ns(self, topic: str, sequence: int, stamp_ns: int) -> int | None:
        """Return the delay of a message in nanoseconds, or None if it is lost."""
        if any(each.topic == topic and each.first_ns <= stamp_ns < each.end_ns for each in self._left_out):
            return None
        fault = self._faults.get(topic)
        if fault is None:
            return 0
        lost, late = generator(self._seed, f"link/{self._node}", sequence, topic).random(2)
        if lost < fault.loss:
            return None
        return round((fault.delay_s + fault.jitter_s * float(late)) * 1e9)
