"""Roster: which processes are present, by their liveliness tokens, and which start of each counts."""

from collections.abc import Iterable
from enum import Enum

from dynpf_protocol.keys import ALIVE, READY

from dynpf_runtime.machines.events import Token

__all__ = ["Change", "Roster", "holder"]


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

    @property
    def ready(self) -> set[str]:
        """The processes whose counting start has been ready, even if it is gone by now."""
        return {name for name, boot in self.boots.items() if (name, boot) in self._ready}

    @property
    def present(self) -> set[str]:
        """The processes of which any start is alive."""
        return {name for name, boots in self._alive.items() if boots}

    def take(self, token: Token) -> Change:
        """Note the token of one of ``names``, and return what it changes."""
        name, boot, ready = holder(token)
        if ready:
            if token.present:  # the end of readiness needs no handling: the token of life disappears with it
                self._ready.add((name, boot))
            return Change.NONE
        alive = self._alive[name]
        if token.present:
            if boot not in alive:
                alive.append(boot)
            counting = self.boots.setdefault(name, boot)
            return Change.SECOND if counting != boot and (name, counting) in self._ready else Change.NONE
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
