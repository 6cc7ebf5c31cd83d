"""Roster: who is there, by the liveliness tokens that come and go, and which start of a process counts."""

from collections.abc import Iterable
from enum import Enum

from dynpf_protocol.keys import ALIVE, READY

from dynpf_runtime.machines.events import Token

__all__ = ["Change", "Roster", "holder"]


class Change(Enum):
    """What a token means to those who keep the roster."""

    NONE = "none"
    SECOND = "a second start of a process whose first one is ready"
    GONE = "the process was ready, and is gone"


def holder(token: Token) -> tuple[str, str, bool]:
    """Return whose token it is, of which boot, and whether it says that the process is ready, not only alive."""
    prefix = READY if token.key.startswith(READY) else ALIVE
    name, _, boot = token.key[len(prefix) :].rpartition("/")
    return name, boot, prefix == READY


class Roster:
    """The processes ``names`` of a run. Of several starts of one the first counts, until it goes before it was ready.

    ``boots`` has the boot that counts of each process that is there; it is changed in place.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = frozenset(names)
        self.boots: dict[str, str] = {}
        self._alive: dict[str, list[str]] = {name: [] for name in self.names}
        self._ready: set[tuple[str, str]] = set()

    @property
    def ready(self) -> set[str]:
        """Those whose counting start has said that it is ready, though it may be gone by now."""
        return {name for name, boot in self.boots.items() if (name, boot) in self._ready}

    @property
    def present(self) -> set[str]:
        """Those of whom a start is alive."""
        return {name for name, boots in self._alive.items() if boots}

    def take(self, token: Token) -> Change:
        """Note a token of one of ``names``."""
        name, boot, ready = holder(token)
        if ready:
            if token.present:  # that one is ready no more says nothing: the token of its life goes with it
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
        del self.boots[name]  # it left before the run began; another may come, or has come
        if alive:
            self.boots[name] = alive[0]
        return Change.NONE
