"""Faults: what may befall a run, as small values that can be printed, repeated and left out one at a time.

A fault strikes when a process is about to handle its event with a certain number, or when the router sends it the
message with a certain number, both from 0: that is the same moment whatever the machine that simulates it.
"""

from typing import NamedTuple

__all__ = [
    "Clock",
    "Crash",
    "Cut",
    "Delay",
    "Drop",
    "Duplicate",
    "Fault",
    "Freeze",
    "FullDisk",
    "Hang",
    "PowerLoss",
    "Reorder",
    "Slow",
    "Tear",
    "text_of",
]


class Crash(NamedTuple):
    """The process is killed (kill -9) after so many effects of the event; its last ``unsent`` messages are lost."""

    process: str
    event: int
    effects: int = 0
    unsent: int = 0


class Freeze(NamedTuple):
    """A signal stops the process (SIGSTOP), and lets it go on after a time; 0 is never."""

    process: str
    event: int
    for_ns: int


class Hang(NamedTuple):
    """The process's main loop stands still while it stays connected, for a time; 0 is for ever."""

    process: str
    event: int
    for_ns: int


class Cut(NamedTuple):
    """The process is cut off from the router for a time."""

    process: str
    event: int
    for_ns: int


class Slow(NamedTuple):
    """The process takes so much longer for each of its next events."""

    process: str
    event: int
    events: int
    each_ns: int


class Clock(NamedTuple):
    """The wall clock is put forward, or back."""

    process: str
    event: int
    by_ns: int


class PowerLoss(NamedTuple):
    """Everything loses its power; ``draw`` says which blocks the disk had written of what was not synced."""

    process: str
    event: int
    draw: int


class Delay(NamedTuple):
    """The connection is late with a message to the process, and with all after it."""

    process: str
    message: int
    by_ns: int


class Reorder(NamedTuple):
    """The subscription of a message is late in the process, which handles what comes by others first."""

    process: str
    message: int
    by_ns: int


class Duplicate(NamedTuple):
    """A message comes to the process twice: no bus does that, but somebody who repeats what he heard."""

    process: str
    message: int
    by_ns: int


class Drop(NamedTuple):
    """A message never comes to the process, though its connection lives."""

    process: str
    message: int


class FullDisk(NamedTuple):
    """There is room for so many bytes."""

    room: int


class Tear(NamedTuple):
    """The recorder is killed in the midst of a write to its file, of which so many parts in 256 are written."""

    write: int
    kept: int


Fault = Crash | Freeze | Hang | Cut | Slow | Clock | PowerLoss | Delay | Reorder | Duplicate | Drop | FullDisk | Tear


def text_of(fault: Fault) -> str:
    """Return a fault as a person reads it."""
    values = (f"{name}={_value(name, value)}" for name, value in fault._asdict().items())
    return f"{type(fault).__name__}({', '.join(values)})"


def _value(name: str, value: object) -> str:
    return f"{value:_}" if name.endswith("_ns") else f"{value}"
