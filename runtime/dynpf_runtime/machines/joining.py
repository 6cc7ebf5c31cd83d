"""Joining: the stages in which a process joins a run."""

from enum import IntEnum

from dynpf_runtime.machines.effects import NEVER_NS

__all__ = ["Listening", "Stage", "Vacancy"]

_LISTEN_NS = 2_500_000_000
"""How long to listen for a heartbeat that says that this process was there before: five heartbeats of everybody."""

_LINGER_NS = 2_000_000_000
"""How long the token of a process may stay after its end: the router waits for who does not say that it ends."""

_LOOK_AGAIN_NS = 100_000_000


class Stage(IntEnum):
    """How far a process has come."""

    ASKING = 0  # whether its scenario is the router's, and its name is free
    LISTENING = 1  # whether others were ready before: then it may have had predecessors
    JOINING = 2  # alive, but a rival of the same name may have joined at the same moment
    ALIVE = 3
    READY = 4  # it leads the run, and waits until all are ready
    RUNNING = 5


class Listening:
    """Until when a process listens for what its peers say of it, and how that changes."""

    def __init__(self) -> None:
        self.until_ns = NEVER_NS

    def begin(self, now_ns: int) -> None:
        """Listen from now on."""
        self.until_ns = now_ns + _LISTEN_NS

    def again(self, now_ns: int) -> None:
        """Listen anew if it does so: without the router it hears nobody, and what was on its way is lost."""
        if self.until_ns < NEVER_NS:
            self.begin(now_ns)


class Vacancy:
    """How long a process looks whether its name has become free; another's token may linger."""

    def __init__(self, *, lingers: bool) -> None:
        self.look_at_ns = NEVER_NS
        self._linger_ns = _LINGER_NS if lingers else 0
        self._until_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Return whether it is time to look again, and do so once."""
        due = now_ns >= self.look_at_ns
        self.look_at_ns = NEVER_NS if due else self.look_at_ns
        return due

    def is_over(self, now_ns: int) -> bool:
        """Return whether the name has been taken for too long; if not, look again in a moment."""
        if self._until_ns is None:
            self._until_ns = now_ns + self._linger_ns
        self.look_at_ns = now_ns + _LOOK_AGAIN_NS
        return now_ns >= self._until_ns
