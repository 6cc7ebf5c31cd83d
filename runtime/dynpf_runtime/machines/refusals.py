"""Refusals: messages that were not accepted, counted by kind, and told of without drowning what else is told."""

from collections import Counter
from collections.abc import Iterable

from dynpf_protocol.errors import ProtocolError
from dynpf_protocol.keys import AGAIN, BEAT, CONTROL, DATA, JOURNAL, RUN, TICK, topic_of
from dynpf_protocol.printable import printable

from dynpf_runtime.plan import Plan

__all__ = ["AGAIN_NS", "Refusals", "known_names"]

AGAIN_NS = 10_000_000_000
"""How long a kind of refusal is not told of again."""

_CONTROL = "control and beats"
_OTHER = "other keys"


def known_names(plan: Plan) -> frozenset[str]:
    """Return the topics of a run, and what else its nodes say: refusals are counted by these, all others together."""
    said = {prefix.removeprefix(RUN) + node for prefix in (TICK, JOURNAL, AGAIN) for node in plan.graph.nodes}
    return frozenset({*plan.graph.topics, *said})


def _shown(key: str) -> str:
    """Return a key as people know it: a message's topic, or what follows after the common beginning."""
    return topic_of(key)[0] if key.startswith(DATA) else key.removeprefix(RUN).removeprefix("dynpf/")


class _Kind:
    """Refusals for one sort of reason of messages on one topic."""

    __slots__ = ("due_ns", "last", "untold")

    def __init__(self) -> None:
        self.untold = 0  # refused since the last line
        self.due_ns = 0
        self.last = ""


class Refusals:
    """Counts refused messages by topic, and gives one line for the first of each kind, then one in AGAIN_NS at most.

    A kind is one of the ``known`` topics, or all of control, or all others, and the class of the error.
    """

    def __init__(self, known: Iterable[str]) -> None:
        self.counts: Counter[str] = Counter()
        self._known = frozenset(known)
        self._kinds: dict[tuple[str, type[ProtocolError]], _Kind] = {}

    def note(self, key: str, error: ProtocolError, now_ns: int) -> str | None:
        """Count a refused message, and return the line to tell, if any."""
        name = _shown(key)
        if name not in self._known:
            name = _CONTROL if key.startswith((BEAT, CONTROL)) else _OTHER
        self.counts[name] += 1
        kind = self._kinds.setdefault((name, type(error)), _Kind())
        kind.untold += 1
        kind.last = f"{printable(_shown(key), 120)}: message refused: {printable(str(error))}"
        if now_ns < kind.due_ns:
            return None
        kind.due_ns = now_ns + AGAIN_NS
        return self._line(kind)

    def rest(self) -> list[str]:
        """Return a line for each kind of which some have not been told yet."""
        return [self._line(kind) for kind in self._kinds.values() if kind.untold]

    @staticmethod
    def _line(kind: _Kind) -> str:
        more, kind.untold = kind.untold - 1, 0
        return f"{kind.last} (the last of {more + 1} alike)" if more else kind.last
