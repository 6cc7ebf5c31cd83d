"""Frames of reference: the names in the ``frame_id`` of messages, the same in every scenario."""

__all__ = ["MAP", "ROBOT"]

MAP = "map"
"""The fixed frame: the plane in which the robot moves, x and y in metres, z upwards."""

ROBOT = "robot"
"""The estimated robot: x along its heading; ``estimator/transforms`` has its pose in the map."""
