"""Joining: the stages in which a process joins a run."""

from enum import IntEnum

from dynpf_runtime.machines.effects import NEVER_NS

__all__ = ["Listening", "Stage"]

_LISTEN_NS = 2_500_000_000
"""How long to listen for a heartbeat that says that this process was there before: five heartbeats of everybody."""


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
