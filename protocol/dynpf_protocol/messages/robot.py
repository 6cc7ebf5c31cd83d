"""A robot's true state, and its commands."""

from dynpf_protocol.messages.base import Message

__all__ = [
    "Command",
    "RobotState",
]


class RobotState(Message, frozen=True, kw_only=True):
    """The robot's true or reference pose; ``heading_valid`` is false if the reference's heading is known to be bad."""

    schema_name = "dynpf.RobotState"
    x: float  # m
    y: float  # m
    theta: float  # rad
    v: float = 0.0  # m/s
    w: float = 0.0  # rad/s
    heading_valid: bool = True


class Command(Message, frozen=True, kw_only=True):
    """The commanded velocity until the next command.

    A robot that drives moves forward by ``vx``; one that moves in any direction moves along the axes of the map.
    """

    schema_name = "dynpf.Command"
    vx: float = 0.0  # m/s
    vy: float = 0.0  # m/s
    w: float = 0.0  # rad/s
    finished: bool = False  # the robot has nothing left to do
