"""The commands that a robot was given, over time."""

import numpy as np
from dynpf_protocol.messages import Command

from dynpf_experiments.pictures.drawing import Line, Plot
from dynpf_experiments.pictures.source import RunSource, robot_of

__all__ = ["command_plots"]


def command_plots(source: RunSource) -> list[Plot]:
    """Return the commanded velocities and turning rates; those that are 0 throughout are left out."""
    speeds: list[Line] = []
    turns: list[Line] = []
    for topic in source.carrying(Command):
        known = [(at, m) for at, m in source.messages(topic) if isinstance(m, Command)]
        seconds = np.array([at for at, _ in known])
        robot = robot_of(topic.rpartition("/")[0])
        of_robot = f" of {robot}" if robot else ""
        for lines, label, values in (
            (speeds, "vx", [m.vx for _, m in known]),
            (speeds, "vy", [m.vy for _, m in known]),
            (turns, "turning rate", [m.w for _, m in known]),
        ):
            if any(values):
                lines.append(Line(label + of_robot, seconds, np.array(values)))
    plots = (
        Plot("speed", "Commanded speed", "m/s", speeds, signed=True),
        Plot("turn", "Commanded turning rate", "rad/s", turns, signed=True),
    )
    return [plot for plot in plots if plot.lines]
