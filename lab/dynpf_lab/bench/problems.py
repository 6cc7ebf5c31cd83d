"""Problems of the benchmarks: a robot among 15 landmarks, and a robot with a laser on a floor plan. Both are fixed."""

from typing import Any, NamedTuple

import numpy as np

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.motion.model import Displacement
from dynpf.rng import generator
from dynpf.se2 import compose, wrap_angle
from dynpf.types import Float32s, FloatArray
from dynpf_lab.bench import plain

__all__ = ["ALPHA", "LandmarkProblem", "Movement", "ScanProblem", "movement"]

ALPHA = 0.05  # all four of the odometry motion model, on squared movements

STEPS = 40  # a lap among the landmarks
LANDMARKS = 15
ROOM_M = (10.0, 8.0)
RADIUS_M = 2.0
SIGMA_RANGE_M, SIGMA_BEARING = 0.15, 0.05
START_SIGMA = (0.2, 0.2, 0.1)  # m, m, rad: the cloud of a tracking filter

RANGE_MIN_M, RANGE_MAX_M = 0.1, 12.0
FIELD_OF_VIEW = 1.5 * np.pi
SIGMA_HIT_M = 0.1
PASSERS_BY = 0.05  # share of beams that hit obstacles missing in the map
# Back and forth, so that a filter can continue without end.
SHUTTLE = (Displacement(0.2, 0.02, 0.1), Displacement(-0.2, 0.0, -0.1))


class Movement(NamedTuple):
    """A displacement as rotation (rad), translation (m), rotation (rad), and their standard deviations."""

    made: tuple[float, float, float]
    sigma: tuple[float, float, float]


def movement(control: Displacement) -> Movement:
    """Return the movement that ``OdometryMotion``, with ALPHA four times, draws from, for contenders without it."""
    ahead = -1.0 if control.dx < 0.0 else 1.0
    first = float(np.arctan2(ahead * control.dy, ahead * control.dx))
    way, second = ahead * float(np.hypot(control.dx, control.dy)), control.turn - first
    return Movement(
        (first, way, second),
        (
            float(np.sqrt(ALPHA * (first**2 + way**2))),
            float(np.sqrt(ALPHA * (way**2 + first**2 + second**2))),
            float(np.sqrt(ALPHA * (second**2 + way**2))),
        ),
    )


class LandmarkProblem:
    """A robot drives circles: ``landmarks`` (L, 2), one ``control`` for every step, and one lap of T steps.

    ``truth`` (T, 3) is the pose after each step, ``ranges`` and ``bearings`` (T, L) are the readings there. At the end
    of the lap a filter continues with its beginning.
    """

    def __init__(self) -> None:
        rng = generator(0, "bench", 0, "landmarks")
        self.landmarks: FloatArray = rng.uniform((0.0, 0.0), ROOM_M, (LANDMARKS, 2))
        turn = 2.0 * np.pi / STEPS
        chord = 2.0 * RADIUS_M * np.sin(0.5 * turn)
        self.control = Displacement(chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn)
        self.start = np.array([0.5 * ROOM_M[0] + RADIUS_M, 0.5 * ROOM_M[1], 0.5 * np.pi])
        poses = [self.start]
        for _ in range(STEPS):
            poses.append(compose(poses[-1], np.array(self.control)))
        self.truth: FloatArray = np.array(poses[1:])
        east, north = self.landmarks.T[:, None] - self.truth.T[:2, :, None]
        noise = rng.standard_normal((2, STEPS, LANDMARKS))
        self.ranges: FloatArray = np.hypot(east, north) + SIGMA_RANGE_M * noise[0]
        bearings = np.arctan2(north, east) - self.truth[:, 2:] + SIGMA_BEARING * noise[1]
        self.bearings: FloatArray = np.asarray(wrap_angle(bearings))

    def cloud(self, n: int) -> Float32s:
        """Return poses (3, n) drawn from the prior."""
        return _around(self.start, n)

    def as_request(self) -> dict[str, Any]:
        """Return the problem as the JSON that a peer's process is sent."""
        made, sigma = movement(self.control)
        return {
            "start": self.start.tolist(),
            "start_sigma": START_SIGMA,
            "control": made,
            "control_sigma": sigma,
            "landmarks": self.landmarks.tolist(),
            "ranges": self.ranges.tolist(),
            "bearings": self.bearings.tolist(),
            "sigma_range": SIGMA_RANGE_M,
            "sigma_bearing": SIGMA_BEARING,
        }


class ScanProblem:
    """A robot moves back and forth where the map leaves most room, and scans after each step.

    ``truth`` (2, 3) is the pose after each of the two steps of ``SHUTTLE``, ``angles`` (B,) and ``ranges`` (2, B) the
    scans: the map's ranges with noise, some of them cut short. The first step starts from ``start``.
    """

    def __init__(self, grid: OccupancyGrid, beams: int) -> None:
        self.grid = grid
        self.controls = SHUTTLE
        self.start = _roomiest(grid)
        there = compose(self.start, np.array(SHUTTLE[0]))
        self.truth: FloatArray = np.array([there, compose(there, np.array(SHUTTLE[1]))])
        self.angles = (FIELD_OF_VIEW * ((np.arange(beams) + 0.5) / beams - 0.5)).astype(np.float32)
        rng = generator(0, "bench", 0, "scan")
        seen = plain.Rays(grid).scans(self.truth.T.astype(np.float32), self.angles, RANGE_MAX_M)
        noisy = seen + SIGMA_HIT_M * rng.standard_normal(seen.shape)
        passed = rng.random(seen.shape) < PASSERS_BY
        noisy[passed] *= rng.random(int(np.count_nonzero(passed)))
        self.ranges: Float32s = np.clip(noisy, RANGE_MIN_M, RANGE_MAX_M).astype(np.float32)
        self.ranges[seen >= RANGE_MAX_M] = RANGE_MAX_M

    def cloud(self, n: int) -> Float32s:
        """Return poses (3, n) of a tracking filter: 0.2 m and 0.1 rad around the start."""
        return _around(self.start, n)

    def anywhere(self, n: int) -> Float32s:
        """Return poses (3, n) uniform over the free cells."""
        rng = generator(0, "bench", 0, "anywhere")
        row, column = np.nonzero(self.grid.free)
        chosen = rng.integers(0, len(row), n)
        x, y = self.grid.to_map(column[chosen] + rng.random(n), row[chosen] + rng.random(n))
        return np.stack((x, y, rng.uniform(-np.pi, np.pi, n))).astype(np.float32)


def _around(pose: FloatArray, n: int) -> Float32s:
    noise = generator(0, "bench", 0, "cloud").standard_normal((n, 3)) * START_SIGMA
    return np.ascontiguousarray((pose + noise).T, dtype=np.float32)


def _roomiest(grid: OccupancyGrid) -> FloatArray:
    """Return a pose at the free cell farthest from all walls, with a heading along neither axis."""
    gaps = np.where(grid.free, plain.distances(grid.occupied), 0.0)
    row, column = np.unravel_index(np.argmax(gaps), gaps.shape)
    x, y = grid.to_map(int(column) + 0.5, int(row) + 0.5)
    return np.array([x, y, 0.3])
