"""Roster: which processes are present, by their liveliness tokens, and which start of each counts."""

from collections import Counter
from collections.abc import Iterable
from enum import Enum

from dynpf_protocol.keys import ALIVE, READY

from dynpf_runtime.machines.events import Token

__all__ = ["MOST_STARTS", "Change", "Roster", "holder"]


MOST_STARTS = 8
"""How many starts of a process are kept at most."""

_TOLD = 2
"""How many second starts of a process are told of at most."""


class Change(Enum):
    """What a token changes."""

    NONE = "none"
    SECOND = "a second start of a process whose first one is ready"
    GONE = "the process was ready, and is gone"


def holder(token: Token) -> tuple[str, str, bool]:
    """Return process and boot of a token, and whether it is a token of readiness rather than of life."""
    prefix = READY if token.key.startswith(READY) else ALIVE
    name, _, boot = token.key[len(prefix) :].rpartition("/")
    return name, boot, prefix == READY


class Roster:
    """The presence of the processes ``names`` of a run.

    Of several starts of a process the first counts, unless it leaves before it is ready. ``boots`` has the counting
    boot of each present process; it changes in place.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = frozenset(names)
        self.boots: dict[str, str] = {}
        self._alive: dict[str, list[str]] = {name: [] for name in self.names}
        self._ready: set[tuple[str, str]] = set()
        self._seconds: Counter[str] = Counter()

    @property
    def ready(self) -> set[str]:
        """The processes whose counting start has been ready, even if it is gone by now."""
        return {name for name, boot in self.boots.items() if (name, boot) in self._ready}

    @property
    def present(self) -> set[str]:
        """The processes whose counting start is alive."""
        return {name for name, boots in self._alive.items() if self.boots.get(name) in boots}

    def take(self, token: Token) -> Change:
        """Note the token of one of ``names``, and return what it changes."""
        name, boot, ready = holder(token)
        alive = self._alive[name]
        if ready:  # its end needs no handling: the token of life disappears with it
            # It may come before the token of life, by another subscription; of strangers' few are kept.
            if token.present and (boot in alive or sum(other == name for other, _ in self._ready) < MOST_STARTS):
                self._ready.add((name, boot))
            return Change.NONE
        if token.present:
            counting = self.boots.setdefault(name, boot)
            if boot not in alive and (boot == counting or len(alive) < MOST_STARTS):
                alive.append(boot)
            if counting == boot or (name, counting) not in self._ready:
                return Change.NONE
            self._seconds[name] += 1
            return Change.SECOND if self._seconds[name] <= _TOLD else Change.NONE
        if boot in alive:
            alive.remove(boot)
        if self.boots.get(name) != boot:
            return Change.NONE
        if (name, boot) in self._ready:
            return Change.GONE
        del self.boots[name]  # it left before the run began; another start may replace it
        if alive:
            self.boots[name] = alive[0]
        return Change.NONE
