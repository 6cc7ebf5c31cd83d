"""Frames of reference: the names that messages with a ``frame_id`` use, the same in every scenario."""

__all__ = ["MAP", "ROBOT"]

MAP = "map"
"""The fixed frame: the plane in which the robot moves, x and y in metres, z upwards."""

ROBOT = "robot"
"""Where the estimator has the robot: x along its heading; ``estimator/transforms`` place it in the map."""
