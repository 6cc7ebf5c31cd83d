"""What disturbed a run and nobody reported: topics that fell silent, and robots that were elsewhere at once."""

from collections.abc import Iterator

import numpy as np
from dynpf_protocol.messages import RobotState
from dynpf_protocol.printable import printable
from dynpf_protocol.topics import is_act

from dynpf_experiments.pictures.event import Event
from dynpf_experiments.pictures.source import RunSource

__all__ = ["leaps", "silences"]

SILENT_S, SILENT_PERIODS = 1.0, 10.0
"""A topic is silent if its next message comes so late, and so many times later than usual."""

LEAST_PERIODS = 20
"""Messages of a topic from which it is known how often they come."""

LEAP_M, LEAP_M_S = 0.5, 5.0
"""A reference that moves so far at once, and so fast, leaps: the robot was carried."""

MOST_OF_A_KIND = 50
_HEARD_BY_FEW = ("truth/", "snapshot/", "log", "notice", "diagnostics", "recorder/")


def silences(source: RunSource) -> Iterator[Event]:
    """Yield when topics that come at a steady rate did not come, each at its last message before."""
    for topic in sorted(source.recording.schemas):
        if topic.startswith(_HEARD_BY_FEW) or is_act(topic):
            continue
        seconds = source.seconds(source.records(topic))
        periods = np.diff(seconds)
        if periods.size < LEAST_PERIODS:
            continue
        usual = float(np.median(periods))
        for index in np.flatnonzero(periods > max(SILENT_S, SILENT_PERIODS * usual))[:MOST_OF_A_KIND]:
            text = f"silent for {periods[index]:.1f} s; it usually comes every {usual:.2g} s"
            yield Event(float(seconds[index]), "silence", "warning", printable(topic), text)


def leaps(source: RunSource) -> Iterator[Event]:
    """Yield when a robot, or its reference, was elsewhere at once."""
    for topic in source.carrying(RobotState):
        known = [(at, m.x, m.y) for at, m in source.messages(topic) if isinstance(m, RobotState)]
        if len(known) < 2:
            continue
        seconds, x, y = np.array(known).T
        moved, took = np.hypot(np.diff(x), np.diff(y)), np.maximum(np.diff(seconds), 1e-9)
        for index in np.flatnonzero((moved > LEAP_M) & (moved > LEAP_M_S * took))[:MOST_OF_A_KIND]:
            here, there = f"({x[index]:.2f}, {y[index]:.2f})", f"({x[index + 1]:.2f}, {y[index + 1]:.2f})"
            text = f"{moved[index]:.2f} m elsewhere within {took[index]:.2g} s, from {here} to {there} m"
            yield Event(float(seconds[index + 1]), "leap", "warning", printable(topic), text)
