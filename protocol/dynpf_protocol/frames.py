"""Frames of reference: the names that messages with a ``frame_id`` use, the same in every scenario."""

__all__ = ["CAMERA", "MAP", "ROBOT"]

MAP = "map"
"""The fixed frame: the plane of the workspace or room, x and y in metres, z upwards."""

ROBOT = "robot"
"""Where the estimator has the robot: x forwards, or along its gripper; ``estimator/transforms`` place it in the map."""

CAMERA = "camera"
"""The image of the overhead camera; nothing is placed in it."""
