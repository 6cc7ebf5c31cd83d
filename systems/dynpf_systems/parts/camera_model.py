"""The geometry of the overhead camera: the projection of the workspace into the frame."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf.portable import product, sincos
from dynpf.types import Positive
from dynpf.vision.board import Board
from dynpf.vision.projection import PlaneProjection

__all__ = ["CameraParams", "Colour", "calibration_pairs", "project", "projection_of"]

Level = Annotated[int, Meta(ge=0, le=255)]
Colour = tuple[Level, Level, Level]  # blue, green, red
Tilt = Annotated[float, Meta(ge=-0.5, le=0.5)]


class CameraParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A camera above the middle of a square workspace, looking at it; pixels, metres, radians, grey levels."""

    width_px: Annotated[int, Meta(ge=64, le=4096)] = 1280
    height_px: Annotated[int, Meta(ge=64, le=4096)] = 1024
    workspace_m: Positive = 2.0  # side of the workspace, centred at the origin
    height_m: Positive = 2.5
    focal_px: Positive = 1140.0
    rotation_rad: float = 0.02  # about the optical axis
    tilt_x_rad: Tilt = 0.02  # about the workspace's x axis
    tilt_y_rad: Tilt = -0.015  # about the workspace's y axis
    radial_distortion: Annotated[float, Meta(ge=-0.3, le=0.3)] = -0.03  # k1 for coordinates in focal lengths
    table_colour: Colour = (196, 204, 206)
    border_colour: Colour = (176, 184, 186)  # thin line around the workspace
    part_colour: Colour = (60, 110, 190)
    robot_colour: Colour = (120, 60, 30)  # darker in grey than the parts, which may have its size
    gripper_colour: Colour = (235, 235, 235)
    light_falloff: Annotated[float, Meta(ge=0, le=0.9)] = 0.18  # from the brightest point to the farthest corner
    light_slope: Annotated[float, Meta(ge=-0.9, le=0.9)] = 0.12  # from the left side to the right
    blur_sigma_px: Annotated[float, Meta(ge=0, le=3)] = 1.0
    noise_std: Annotated[float, Meta(ge=0, le=30)] = 2.0  # grey levels, each colour on its own
    jpeg_quality: Annotated[int, Meta(ge=1, le=100)] = 85
    board: Board | None = None  # a calibration board, alone on the table in the run's first frame


def project(points_m: NDArray[np.float64], params: CameraParams) -> NDArray[np.float64]:
    """Map workspace points (..., 2) in metres to pixels (..., 2): the true camera."""
    return projection_of(params).to_pixels(points_m)


def calibration_pairs(params: CameraParams, per_side: int = 7) -> list[list[float]]:
    """Return [u_px, v_px, x_m, y_m] for a square grid of known points, as from a calibration board."""
    ticks = np.linspace(-0.45, 0.45, per_side) * params.workspace_m
    points = np.stack(np.meshgrid(ticks, ticks), axis=2).reshape(-1, 2)
    return [[float(value) for value in row] for row in np.hstack([project(points, params), points])]


def projection_of(params: CameraParams) -> PlaneProjection:
    """Return the pinhole camera: image x to the right and y down; workspace y up in the image without rotations."""
    rotation = product(_turn(2, params.rotation_rad), _turn(0, params.tilt_x_rad), _turn(1, params.tilt_y_rad))
    looking_down = np.array([[1.0], [-1.0], [-1.0]]) * rotation
    columns = np.column_stack([looking_down[:, 0], looking_down[:, 1], [0.0, 0.0, params.height_m]])
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in columns / params.height_m)
    return PlaneProjection(
        homography=(a, b, c),
        radial_distortion=params.radial_distortion,
        centre_px=((params.width_px - 1) / 2, (params.height_px - 1) / 2),
        scale_px=params.focal_px,
    )


def _turn(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the rotation matrix by ``angle`` about a coordinate axis."""
    i, j = [other for other in range(3) if other != axis]
    sign = -1.0 if axis == 1 else 1.0
    matrix = np.eye(3)
    sine, cosine = sincos(angle)
    matrix[i, i] = matrix[j, j] = cosine
    matrix[i, j], matrix[j, i] = -sign * sine, sign * sine
    return matrix
