"""Joining: the stages in which a process joins a run."""

from enum import IntEnum

__all__ = ["Stage"]


class Stage(IntEnum):
    """How far a process has come."""

    ASKING = 0  # whether its scenario is the router's, and its name is free
    LISTENING = 1  # whether others were ready before: then it may have had predecessors
    JOINING = 2  # alive, but a rival of the same name may have joined at the same moment
    ALIVE = 3
    READY = 4  # it leads the run, and waits until all are ready
    RUNNING = 5
