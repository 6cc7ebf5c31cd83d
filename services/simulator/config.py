"""Configuration of the rearrangement workspace; SI units and radians."""

from typing import Annotated

import msgspec
from msgspec import Meta

from services.simulator.camera import CameraParams

__all__ = ["WorkspaceConfig"]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]


class WorkspaceConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="workspace"
):
    """A disc robot with a gripper among disc parts."""

    process_variance: NonNegative = 0.06e-4  # m^2 a tick and coordinate, of the robot's motion (PARTS: 0.06 cm^2)
    grip_tolerance: NonNegative = 0.01  # gap beyond the reach at which the jaws still catch a part
    grip_angle: Positive = 0.2  # the same for the direction
    start_gap: NonNegative = 0.26  # between drawn starts: the robot fits between any two parts
    start_wall_gap: NonNegative = 0.10  # between drawn starts and the walls
    camera: CameraParams | None = None  # the overhead camera; absent: no frames are rendered
