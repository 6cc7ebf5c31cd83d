"""The overhead camera: draws the workspace as a colour frame with uneven light, blur and noise.

Discs are drawn through the exact inverse of the projection, with the profile of a blurred edge, so that their centres
and radii in the frame are known far below a pixel. The constant parts (lit table, workspace coordinates of each pixel,
noise tile) are computed once for each set of parameters.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.directions import directions
from dynpf.portable import erf, sincos, whole
from dynpf.rng import Stream, generator
from dynpf.vision.board import Board
from dynpf_systems.parts.camera_model import CameraParams, Colour, projection_of

__all__ = ["CAMERA_FRAME", "Camera", "DrawnDisc", "board_discs", "encode", "render"]

Frame = NDArray[np.uint8]

CAMERA_FRAME = "camera"
"""The frame of reference of its images; no other message uses it."""

_TILE_MARGIN_PX = 256  # by how much the noise tile exceeds the frame, for random shifts
_EDGE_STEPS = 32  # of the edge profile, per pixel
_EDGE_REACH_PX = 4.0
_LINE_HALF_WIDTH_PX = 1.0
_RIM_POINTS = 16  # of a disc, by which its region is found
_GRIPPER_FROM, _GRIPPER_TO = 0.2, 0.7  # of the radius: far from the rim, so that the fit does not see it


class DrawnDisc(NamedTuple):
    """A disc on the table; with a gripper angle a line shows its direction."""

    x_m: float
    y_m: float
    radius_m: float
    colour: Colour
    gripper_rad: float | None = None


class Camera:
    """A renderer of frames: holds the arrays that depend on the parameters only."""

    def __init__(self, params: CameraParams) -> None:
        self.params = params
        self._projection = projection_of(params)
        self._light = _light(params)
        self._edge = np.float32(_EDGE_REACH_PX), np.float32(_EDGE_STEPS), _edge_profile(params.blur_sigma_px)
        columns, rows = np.meshgrid(np.arange(params.width_px), np.arange(params.height_px))
        points = self._projection.to_workspace(np.stack([columns, rows], axis=2).astype(np.float64))
        self._x_m = np.ascontiguousarray(points[..., 0], dtype=np.float32)
        self._y_m = np.ascontiguousarray(points[..., 1], dtype=np.float32)
        self._empty = self._lit_table()
        self._noise = _noise_tile(params)

    def render(self, discs: Sequence[DrawnDisc], seed: int, tick: int) -> Frame:
        """Draw the discs, later ones on top, into a frame (H, W, 3) BGR; the noise depends on seed and tick."""
        frame = self._empty.copy()
        for disc in discs:
            self._draw(frame, disc)
        return self._with_noise(frame, seed, tick)

    def _draw(self, frame: Frame, disc: DrawnDisc) -> None:
        box, px_per_m = self._seen(disc)
        canvas = frame, self._x_m, self._y_m, self._light, box
        shape = np.array([disc.x_m, disc.y_m, disc.radius_m], dtype=np.float32)
        kernels.drawing.draw_disc(*canvas, shape, px_per_m, self._edge, np.array(disc.colour, dtype=np.float32))
        if disc.gripper_rad is not None:
            sine, cosine = sincos(disc.gripper_rad)
            start, end = _GRIPPER_FROM * disc.radius_m, _GRIPPER_TO * disc.radius_m
            line = np.array([disc.x_m, disc.y_m, cosine, sine, start, end, _LINE_HALF_WIDTH_PX], dtype=np.float32)
            colour = np.array(self.params.gripper_colour, dtype=np.float32)
            kernels.drawing.draw_line(*canvas, line, px_per_m, self._edge, colour)

    def _seen(self, disc: DrawnDisc) -> tuple[tuple[int, int, int, int], np.float32]:
        """Return where the disc is in the frame, and pixels per metre there.

        That are top, bottom, left and right of the region with the disc and its blurred edge, and the square root of
        the area's magnification.
        """
        step = 1e-3
        ends = [[disc.x_m, disc.y_m], [disc.x_m + step, disc.y_m], [disc.x_m, disc.y_m + step]]
        rim = disc.radius_m * directions(_RIM_POINTS) + [disc.x_m, disc.y_m]
        pixels = self._projection.to_pixels(np.concatenate((rim, ends)))
        rim_px, (at, right, up) = pixels[:_RIM_POINTS], pixels[_RIM_POINTS:].tolist()
        area = (right[0] - at[0]) * (up[1] - at[1]) - (right[1] - at[1]) * (up[0] - at[0])
        lowest, highest = rim_px.min(axis=0).tolist(), rim_px.max(axis=0).tolist()
        margin = _EDGE_REACH_PX + 0.03 * (highest[0] - lowest[0]) + 2
        (left, right_end), (top, bottom) = (
            (_pixel(low - margin, size), _pixel(high + margin + 2, size))
            for low, high, size in zip(lowest, highest, (self.params.width_px, self.params.height_px), strict=True)
        )
        return (top, bottom, left, right_end), np.float32(math.sqrt(abs(area)) / step)

    def _lit_table(self) -> Frame:
        outside_m = np.maximum(np.abs(self._x_m), np.abs(self._y_m)) - np.float32(self.params.workspace_m / 2)
        px_per_m = self.params.focal_px / self.params.height_m
        outside_px = np.abs(outside_m) * np.float32(px_per_m) - np.float32(_LINE_HALF_WIDTH_PX)
        reach, steps, profile = self._edge
        index = np.clip((outside_px + reach) * steps, 0, len(profile) - 1)
        cover = profile[whole(index + np.float32(0.5), 0, len(profile) - 1)][..., None]
        table, border = (
            self._light[..., None] * np.array(colour, dtype=np.float32)
            for colour in (self.params.table_colour, self.params.border_colour)
        )
        inside = np.floor(table + np.float32(0.5))
        return whole(inside + cover * (border - inside) + np.float32(0.5), 0, 255, np.uint8)

    def _with_noise(self, frame: Frame, seed: int, tick: int) -> Frame:
        draw = generator(seed, "simulator", tick, "camera noise").integers(0, _TILE_MARGIN_PX, size=3)
        shift_y, shift_x, swap = int(draw[0]), int(draw[1]), bool(draw[2] % 2)
        kernels.drawing.add_noise(frame, self._noise, shift_y, shift_x, -1 if swap else 1)
        return frame


def render(discs: Sequence[DrawnDisc], params: CameraParams, seed: int, tick: int) -> Frame:
    """Draw one frame (H, W, 3) BGR; arrays that depend on ``params`` only are cached."""
    return _camera(params).render(discs, seed, tick)


def board_discs(board: Board, params: CameraParams) -> list[DrawnDisc]:
    """Return the dots of a calibration board on the table, painted like the robot."""
    return [DrawnDisc(x, y, radius, params.robot_colour) for x, y, radius in board.dots()]


def encode(frame: Frame, params: CameraParams) -> bytes:
    """Return the frame as a JPEG file."""
    done, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, params.jpeg_quality])
    if not done:
        raise ValueError(f"cannot encode a frame of shape {frame.shape} as JPEG")
    return bytes(data)


def _pixel(place: float, size: int) -> int:
    """Return the last pixel before ``place``, within the frame; of what is not a number the first."""
    return math.floor(min(place, size)) if place > 0.0 else 0


@lru_cache(maxsize=2)
def _camera(params: CameraParams) -> Camera:
    return Camera(params)


def _light(params: CameraParams) -> NDArray[np.float32]:
    """Return the relative illumination (H, W), 1 in the middle, with falloff towards the corners and a slope."""
    x = np.linspace(-1, 1, params.width_px)[None, :]
    y = np.linspace(-1, 1, params.height_px)[:, None]
    away, farthest = np.square(x + 0.1) + np.square(y - 0.15), 1.1 * 1.1 + 1.15 * 1.15
    falloff = 1 - params.light_falloff * away / farthest
    return np.ascontiguousarray(falloff * (1 + params.light_slope / 2 * x), dtype=np.float32)


def _noise_tile(params: CameraParams) -> NDArray[np.int16]:
    """Return the sensor noise of each colour, in a tile larger than the frame; the same for every seed."""
    rows, columns = params.height_px + _TILE_MARGIN_PX, params.width_px + _TILE_MARGIN_PX
    draws = Stream.of(0, "simulator", 0, "camera noise tile").normals(3, rows * columns).reshape(3, rows, columns)
    draws = np.ascontiguousarray(np.moveaxis(draws, 0, -1))
    return whole(np.rint(draws * np.float32(params.noise_std)), -(2**15), 2**15 - 1, np.int16)


def _edge_profile(blur_sigma_px: float) -> NDArray[np.float32]:
    """Return the coverage by distance outside a straight border: a step convolved with blur and pixel width."""
    sigma = math.sqrt(blur_sigma_px * blur_sigma_px + 1 / 12)
    distance = np.arange(round(2 * _EDGE_REACH_PX * _EDGE_STEPS) + 1) / _EDGE_STEPS - _EDGE_REACH_PX
    return np.array([0.5 * (1.0 - erf(d / (sigma * math.sqrt(2.0)))) for d in distance], dtype=np.float32)
