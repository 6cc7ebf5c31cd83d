"""Synthetic grey images of discs with known centres and radii, to evaluate the detection of discs.

Each is drawn from a seed: discs apart, touching and cut by the border, darker or lighter than the ground or both, in
uneven light, with noise and, as in a photograph, with shading, a glint and a shadow; other shapes lie among them.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.rng import Draws, generator
from dynpf.vision import Disc

__all__ = ["KINDS", "Scene", "Score", "draw_scene", "score"]

KINDS = ("dark on light", "light on dark", "both", "photograph")

_SHAPE = (256, 320)
_FINE = 4  # samples a pixel and axis
_LEAST_SEEN = 0.38  # least visible share of the rim of a disc cut by the border
_ATTEMPTS = 60  # attempts to place each disc


class Scene(NamedTuple):
    """An image (H, W), its discs (K, 3) as x, y, radius in pixels, and whether they touch another or are cut (K,)."""

    image: NDArray[np.uint8]
    discs: NDArray[np.float64]
    touching: NDArray[np.bool_]
    cut: NDArray[np.bool_]


class Score(NamedTuple):
    """The detections of a scene: whether each disc was found, its errors (K,) or NaN, and the number of false discs."""

    found: NDArray[np.bool_]
    centre_error_px: NDArray[np.float64]
    radius_error_px: NDArray[np.float64]
    false_discs: int


def draw_scene(kind: str, seed: int, number: int) -> Scene:
    """Return the scene ``number`` of a kind; raises ValueError when the kind is unknown."""
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: expected one of {', '.join(KINDS)}")
    random = generator(seed, "scene", number, kind)
    ground, levels = _greys(kind, random)
    discs, touching = _draw_discs(random)
    shapes = [] if kind == "photograph" else _other_shapes(discs, random)
    image = _painted(ground, discs, random.choice(levels, len(discs)), shapes, random, photograph=kind == "photograph")
    image = cv2.GaussianBlur(image, (0, 0), float(random.uniform(0.5, 0.9))) * _light(random)
    image += random.uniform(0.0, 4.0) * random.standard_normal(_SHAPE)
    low = discs[:, :2] - discs[:, 2:] < -0.5
    high = discs[:, :2] + discs[:, 2:] > np.array(_SHAPE[::-1]) - 0.5
    grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Scene(grey, discs, touching, np.asarray((low | high).any(axis=1)))


def score(scene: Scene, found: tuple[Disc, ...]) -> Score:
    """Match detections to true discs: a match is off by less than a fifth of the radius, in position and in radius."""
    count = len(scene.discs)
    hit, centre, radius = np.zeros(count, dtype=bool), np.full(count, np.nan), np.full(count, np.nan)
    false_discs = 0
    for disc in found:
        offset = np.hypot(*(scene.discs[:, :2] - [disc.x_px, disc.y_px]).T)
        wrong = np.maximum(offset, np.abs(scene.discs[:, 2] - disc.radius_px)) / scene.discs[:, 2]
        wrong[hit] = np.inf
        best = int(np.argmin(wrong))
        if wrong[best] < 0.2:
            hit[best], centre[best] = True, offset[best]
            radius[best] = abs(scene.discs[best, 2] - disc.radius_px)
        else:
            false_discs += 1
    return Score(hit, centre, radius, false_discs)


def _greys(kind: str, random: Draws) -> tuple[float, NDArray[np.float64]]:
    """Return the ground's grey level, and the possible levels of discs."""
    if kind == "light on dark":
        ground = float(random.uniform(25.0, 80.0))
        return ground, ground + random.uniform(60.0, 140.0, 4)
    if kind == "both":
        ground = float(random.uniform(105.0, 135.0))
        return ground, ground + random.uniform(50.0, 80.0, 4) * np.array([-1.0, 1.0, -1.0, 1.0])
    ground = float(random.uniform(170.0, 225.0))
    return ground, ground - random.uniform(60.0, 150.0, 4)


def _draw_discs(random: Draws) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return discs that do not overlap, a third free, a third beside another and a third across the border."""
    height, width = _SHAPE
    discs: list[tuple[float, float, float]] = []
    touching: list[bool] = []
    for index in range(int(random.integers(3, 13))):
        for _ in range(_ATTEMPTS):
            radius = float(random.uniform(7.0, 26.0))
            partner = int(random.integers(len(discs))) if index % 3 == 1 and discs else -1
            if partner >= 0:
                x, y, other = discs[partner]
                angle, reach = random.uniform(0.0, math.tau), radius + other + random.uniform(0.0, 0.6)
                candidate = (x + reach * math.cos(angle), y + reach * math.sin(angle), radius)
            elif index % 3 == 2:
                candidate = _across_the_border(radius, random)
            else:
                candidate = (random.uniform(radius, width - radius), random.uniform(radius, height - radius), radius)
            gaps = [math.dist(candidate[:2], disc[:2]) - radius - disc[2] for disc in discs]
            clear = all(gap >= (0.0 if i == partner else 3.0) for i, gap in enumerate(gaps))
            if clear and _share_of_rim_seen(candidate) >= _LEAST_SEEN:
                if partner >= 0:
                    touching[partner] = True
                discs.append(candidate)
                touching.append(partner >= 0)
                break
    return np.array(discs), np.array(touching)


def _across_the_border(radius: float, random: Draws) -> tuple[float, float, float]:
    height, width = _SHAPE
    along, beyond = random.uniform(0.0, 1.0), random.uniform(-0.3, 0.9) * radius
    return [
        (along * width, beyond, radius),
        (along * width, height - 1 - beyond, radius),
        (beyond, along * height, radius),
        (width - 1 - beyond, along * height, radius),
    ][int(random.integers(4))]


def _share_of_rim_seen(disc: tuple[float, float, float]) -> float:
    angle = np.arange(90) * (math.tau / 90)
    x, y = disc[0] + disc[2] * np.cos(angle), disc[1] + disc[2] * np.sin(angle)
    return float(((x > 0) & (y > 0) & (x < _SHAPE[1] - 1) & (y < _SHAPE[0] - 1)).mean())


def _other_shapes(discs: NDArray[np.float64], random: Draws) -> list[NDArray[np.float64]]:
    """Return the corners of rectangles apart from the discs."""
    shapes = []
    for _ in range(3):
        centre = random.uniform(0.1, 0.9, 2) * _SHAPE[::-1]
        half, turn = random.uniform(4.0, 24.0, 2), random.uniform(0.0, math.pi)
        if np.all(np.hypot(*(discs[:, :2] - centre).T) > discs[:, 2] + np.hypot(*half) + 4.0):
            axis = np.array([math.cos(turn), math.sin(turn)])
            across = np.array([-axis[1], axis[0]])
            signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
            shapes.append(centre + signs[:, :1] * half[0] * axis + signs[:, 1:] * half[1] * across)
    return shapes[: int(random.integers(len(shapes) + 1))]


def _painted(
    ground: float,
    discs: NDArray[np.float64],
    levels: NDArray[np.float64],
    shapes: list[NDArray[np.float64]],
    random: Draws,
    *,
    photograph: bool,
) -> NDArray[np.float64]:
    """Return the scene in even light (H, W); each pixel is the mean over its area."""
    canvas: NDArray[np.float64] = np.full((_FINE * _SHAPE[0], _FINE * _SHAPE[1]), ground)
    if photograph:
        for disc in discs:
            around, x, y = _window(canvas, disc)
            shadow = np.exp(-((((x - 0.45) ** 2 + (y - 0.35) ** 2) / 0.9) ** 4))
            around *= 1.0 - random.uniform(0.1, 0.3) * shadow
    for corners in shapes:
        cv2.fillPoly(canvas, [np.rint(_FINE * (corners + 0.5)).astype(np.int32)], float(random.choice(levels)))
    for disc, level in zip(discs, levels, strict=True):
        around, x, y = _window(canvas, disc)
        inside = x**2 + y**2 <= 1.0
        shade = 1.0 - 0.15 * (x + y) if photograph else np.ones(inside.shape)
        around[inside] = (level * shade)[inside]
        if photograph:
            around[(x + 0.4) ** 2 + (y + 0.3) ** 2 <= 0.15**2] = ground + 20.0
    return np.asarray(canvas.reshape(_SHAPE[0], _FINE, _SHAPE[1], _FINE).mean(axis=(1, 3)))


def _window(
    canvas: NDArray[np.float64], disc: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the samples around a disc, and their offsets from its centre, in radii, right (1, w) and down (h, 1)."""
    cx, cy, radius = disc
    first = np.floor(_FINE * (disc[:2] - 2.2 * radius)).astype(int)
    last = np.ceil(_FINE * (disc[:2] + 2.2 * radius)).astype(int)
    columns = np.arange(max(first[0], 0), min(last[0], canvas.shape[1]))
    rows = np.arange(max(first[1], 0), min(last[1], canvas.shape[0]))
    x = ((columns + 0.5) / _FINE - 0.5 - cx) / radius
    y = ((rows + 0.5) / _FINE - 0.5 - cy) / radius
    return canvas[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], x[None, :], y[:, None]


def _light(random: Draws) -> NDArray[np.float64]:
    """Return the relative illumination (H, W), with falloff towards the corners and a slope, down to a half."""
    y, x = np.mgrid[-1 : 1 : _SHAPE[0] * 1j, -1 : 1 : _SHAPE[1] * 1j]
    slope: Any = random.uniform(-0.15, 0.15, 2)
    light = (1.0 - random.uniform(0.0, 0.2) * (x**2 + y**2)) * (1.0 + slope[0] * x + slope[1] * y)
    return np.asarray(light / light.max())
