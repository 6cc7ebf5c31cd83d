"""A picture of the rearrangement workspace, as shapes."""

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import (
    ArrowPrimitive,
    Color,
    CylinderPrimitive,
    LinePrimitive,
    Point3,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    Vector3,
    planar_pose,
)
from numpy.typing import NDArray

from dynpf.fields.layout import Layout

__all__ = ["draw_scene"]

WALL = Color(r=0.35, g=0.35, b=0.35)
GOAL = Color(r=0.3, g=0.7, b=0.3, a=0.4)
PART = Color(r=0.85, g=0.55, b=0.1)
ROBOT = Color(r=0.15, g=0.4, b=0.8)


def draw_scene(pose: NDArray[np.float64], parts: NDArray[np.float64], layout: Layout, now: Timestamp) -> SceneUpdate:
    """Return walls, goals, parts and robot with its gripper as cylinders, lines and an arrow."""
    x, y, theta = pose.tolist()
    radius = layout.robot_radius
    gripper = ArrowPrimitive(
        pose=planar_pose(x, y, theta),
        shaft_length=radius,
        shaft_diameter=0.2 * radius,
        head_length=0.3 * radius,
        head_diameter=0.4 * radius,
        color=ROBOT,
    )
    discs = zip(layout.radii.tolist(), layout.goals.tolist(), parts.tolist(), strict=True)
    goals, bodies = [], []
    for size, goal, part in discs:
        goals.append(_cylinder(goal[0], goal[1], size, 0.005, GOAL))
        bodies.append(_cylinder(part[0], part[1], size, 0.05, PART))
    return SceneUpdate(
        entities=(
            SceneEntity(timestamp=now, frame_id=frames.MAP, id="walls", lines=(_walls(layout),)),
            SceneEntity(timestamp=now, frame_id=frames.MAP, id="goals", cylinders=tuple(goals)),
            SceneEntity(timestamp=now, frame_id=frames.MAP, id="parts", cylinders=tuple(bodies)),
            SceneEntity(
                timestamp=now,
                frame_id=frames.MAP,
                id="robot",
                cylinders=(_cylinder(x, y, radius, 0.08, ROBOT),),
                arrows=(gripper,),
            ),
        )
    )


def _cylinder(x: float, y: float, radius: float, height: float, color: Color) -> CylinderPrimitive:
    size = Vector3(x=2.0 * radius, y=2.0 * radius, z=height)
    return CylinderPrimitive(pose=planar_pose(x, y, 0.0), size=size, bottom_scale=1.0, top_scale=1.0, color=color)


def _walls(layout: Layout) -> LinePrimitive:
    x, y = layout.half_size.tolist()
    corners = tuple(Point3(x=a, y=b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))
    loop = 1  # Foxglove's LINE_LOOP
    return LinePrimitive(
        type=loop, pose=planar_pose(0.0, 0.0, 0.0), thickness=0.01, scale_invariant=False, points=corners, color=WALL
    )
