"""Roster: which processes are present, by their liveliness tokens, and which start of each counts.

Each start of a process has a name of its own. In lockstep a process that is started again in mid-run takes over what
its predecessor has said: its messages keep the *boot*, which is the name of the first start. The name of a later start
is that boot, how many starts were before, and something of its own: ``a1b2.1.c3d4``.
"""

from collections import Counter
from collections.abc import Iterable
from enum import Enum

from dynpf_protocol.keys import ALIVE, READY

from dynpf_runtime.machines.events import Token

__all__ = ["MOST_STARTS", "Change", "Operators", "Roster", "boot_of", "follows", "holder", "next_start", "was_before"]

MOST_STARTS = 8
"""How many starts of a process are kept at most."""

MOST_OPERATORS = 64
"""How many operators may act on a run."""

_TOLD = 2
"""How many second starts of a process are told of at most."""


class Change(Enum):
    """What a token changes."""

    NONE = "none"
    SECOND = "a second start of a process whose first one is ready"
    GONE = "the process was ready, and is gone"
    ANOTHER = "another start counts, because the first one left before it was ready"
    BACK = "the process is back: connected again, or started again"


def boot_of(start: str) -> str:
    """Return the boot of the messages of a process by the name of any of its starts."""
    return start.partition(".")[0]


def next_start(start: str, own: str) -> str:
    """Return the name of the start that takes over from ``start``; ``own`` sets it apart from rivals."""
    return f"{boot_of(start)}.{_rank(start) + 1}.{own}"


def follows(start: str, before: str) -> bool:
    """Return whether the one who started as ``start`` takes over from ``before``."""
    return boot_of(start) == boot_of(before) and _rank(start) > _rank(before)


def was_before(name: str, start: str) -> bool:
    """Return whether ``name`` is what the one who is known as ``start`` called itself before it took over."""
    return start.count(".") == 2 and _own(start) == name


def _own(start: str) -> str:
    """Return what sets a start apart: it keeps that if it learns later from whom it takes over."""
    return start.rpartition(".")[2]


def _rank(start: str) -> int:
    """Return how many starts were before; a stranger may call itself anything."""
    rank = start.partition(".")[2].partition(".")[0]
    return int(rank) if rank.isdecimal() and rank.isascii() else 0


def holder(token: Token) -> tuple[str, str, bool]:
    """Return process and boot of a token, and whether it is a token of readiness rather than of life."""
    prefix = READY if token.key.startswith(READY) else ALIVE
    name, _, boot = token.key[len(prefix) :].rpartition("/")
    return name, boot, prefix == READY


class Operators(set[str]):
    """The starts of the operators who are there: several may act on a run."""

    def take(self, token: Token) -> None:
        """Note the token of an operator; of strangers' many some are kept."""
        start = holder(token)[1]
        if not token.present:
            self.discard(start)
        elif len(self) < MOST_OPERATORS:
            self.add(start)


class Roster:
    """The presence of the processes ``names`` of a run.

    Of several starts of a process the first counts, unless it leaves before it is ready; when it is gone, one that
    takes over from it. ``starts`` has the counting start of each process, ``boots`` the boot of its messages; they
    change in place.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = frozenset(names)
        self.starts: dict[str, str] = {}
        self.boots: dict[str, str] = {}
        self._alive: dict[str, list[str]] = {name: [] for name in self.names}
        self._ready: set[tuple[str, str]] = set()
        self._gone: set[tuple[str, str]] = set()
        self._left: set[str] = set()  # who has been there, and was not ready
        self._seconds: Counter[str] = Counter()

    @property
    def ready(self) -> set[str]:
        """The processes whose counting start has been ready, even if it is gone by now."""
        return {name for name, start in self.starts.items() if (name, start) in self._ready}

    @property
    def due(self) -> dict[str, str]:
        """The counting starts that the run needs: whoever is started again has to take over from them."""
        return {name: start for name, start in self.starts.items() if self._is_due(name, start)}

    @property
    def present(self) -> set[str]:
        """The processes whose counting start is alive."""
        return {name for name, alive in self._alive.items() if self.starts.get(name) in alive}

    def know(self, name: str, start: str) -> None:
        """Note the counting start of a process that is gone, by the word of another, unless one is known."""
        if name not in self.starts:
            self._count(name, start)
            self._ready.add((name, start))
            self._gone.add((name, start))  # if it comes, it is back: it may have missed what was said meanwhile

    def correct(self, name: str, start: str) -> None:
        """Have a start count, or one that takes over from it, instead of one that is no start of the run."""
        if boot_of(self.starts.get(name, "")) != boot_of(start):
            self._ready.add((name, start))
            self._count(name, next((other for other in self._alive[name] if follows(other, start)), start))
            if self.starts[name] not in self._alive[name]:
                self._gone.add((name, self.starts[name]))

    def take(self, token: Token, *, begun: bool = False) -> Change:
        """Note the token of one of ``names``, and return what it changes; once the run has ``begun``, no boot does."""
        name, start, ready = holder(token)
        alive = self._alive[name]
        if ready:  # its end needs no handling: the token of life disappears with it
            # It may come before the token of life, by another subscription; of strangers' few are kept.
            if token.present and (start in alive or sum(other == name for other, _ in self._ready) < MOST_STARTS):
                self._ready.add((name, start))
            return Change.NONE
        return self._appear(name, start, begun=begun) if token.present else self._leave(name, start, alive)

    def _appear(self, name: str, start: str, *, begun: bool) -> Change:
        alive = self._alive[name]
        counting, change = self.starts.get(name), Change.NONE
        known = start in alive
        if counting is None:
            self._count(name, start)
            change = Change.ANOTHER if name in self._left else Change.NONE
        if not known and (start == self.starts[name] or len(alive) < MOST_STARTS):
            alive.append(start)
        if counting is None:
            return change
        if start == counting:
            back = not known and (name, start) in self._gone
            self._gone.discard((name, start))
            return Change.BACK if back else Change.NONE
        takes_over = follows(start, counting) and (counting not in alive or _own(start) == _own(counting))
        renamed = was_before(counting, start) and not begun  # it has learnt from whom it takes over
        if renamed or (takes_over and self._is_due(name, counting)):
            self._count(name, start)
            return Change.BACK
        if was_before(start, counting) or not self._is_due(name, counting):
            return Change.NONE
        self._seconds[name] += 1
        return Change.SECOND if self._seconds[name] <= _TOLD else Change.NONE

    def _leave(self, name: str, start: str, alive: list[str]) -> Change:
        if start in alive:
            alive.remove(start)
        if self.starts.get(name) != start:
            return Change.NONE
        if self._is_due(name, start):
            heirs = [other for other in alive if follows(other, start)]
            if heirs:
                self._count(name, heirs[0])
                return Change.BACK
            self._gone.add((name, start))
            return Change.GONE
        del self.starts[name], self.boots[name]  # it left before the run began; another start may replace it
        self._left.add(name)
        if alive:
            self._count(name, alive[0])
            return Change.ANOTHER
        return Change.NONE

    def _is_due(self, name: str, start: str) -> bool:
        """Return whether the run needs a start: it has been ready, or takes over from one that was."""
        return (name, start) in self._ready or _rank(start) > 0

    def _count(self, name: str, start: str) -> None:
        self.starts[name], self.boots[name] = start, boot_of(start)
