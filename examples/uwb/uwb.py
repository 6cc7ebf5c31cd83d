"""Ranges to ultra-wideband anchors: the message, the simulated sensor, and the model that a filter weighs with."""

from typing import Annotated, Any

import msgspec
import numpy as np
from dynpf_lab import Draws, Message, Sensor
from dynpf_protocol.messages import RobotState
from msgspec import Meta
from numpy.typing import NDArray

from dynpf.portable import hypot

Anchors = dict[str, tuple[float, float]]  # m
Positive = Annotated[float, Meta(gt=0.0)]
Floats = NDArray[Any]


class Ranges(Message, frozen=True, kw_only=True):
    """Ranges to the anchors in view, m."""

    schema_name = "uwb.Ranges"
    anchors: tuple[str, ...]
    ranges: tuple[float, ...]


class Ranging(Sensor, frozen=True, kw_only=True):
    """Range to each anchor with Gaussian noise."""

    topic = "ranges"
    message = Ranges
    anchors: Anchors
    sigma: Positive = 0.1  # m

    def sense(self, truth: RobotState, draws: Draws) -> Ranges:
        x, y = np.array(list(self.anchors.values())).T
        noise = self.sigma * draws.standard_normal(len(self.anchors))
        ranges = np.maximum(hypot(x - truth.x, y - truth.y) + noise, 0.0)
        return Ranges(anchors=tuple(self.anchors), ranges=tuple(ranges.tolist()))


class AnchorRanges:
    """Independent Gaussian ranges: p(r | x) = N(r; |x - a|, sigma^2) for each anchor a."""

    reading = Ranges

    class Params(msgspec.Struct, frozen=True):
        anchors: Anchors
        sigma: Positive = 0.2  # m

    def __init__(self, params: Params) -> None:
        self.params = params

    def admit(self, particles: Floats, weights: Floats, reading: Ranges) -> Ranges | None:
        return reading if set(reading.anchors) <= self.params.anchors.keys() else None

    def log_likelihood(self, particles: Floats, reading: Ranges) -> Floats:
        errors = self.innovation(particles, reading) / self.params.sigma
        return (-0.5 * (errors * errors).sum(axis=0)).astype(particles.dtype)

    def innovation(self, states: Floats, reading: Ranges) -> Floats:
        dx, dy = self._offsets(states, reading)
        return np.array(reading.ranges)[:, None] - hypot(dx, dy)

    def jacobian(self, states: Floats, reading: Ranges) -> Floats:
        dx, dy = self._offsets(states, reading)
        distances = np.maximum(hypot(dx, dy), 1e-6)
        return np.stack([dx / distances, dy / distances, np.zeros_like(dx)], axis=1)

    def noise(self, reading: Ranges) -> Floats:
        return self.params.sigma**2 * np.eye(len(reading.ranges))

    def angular(self, reading: Ranges) -> NDArray[np.bool_]:
        return np.zeros(len(reading.ranges), dtype=np.bool_)

    def example(self) -> Ranges:
        names = tuple(self.params.anchors)
        return Ranges(anchors=names, ranges=(1.0,) * len(names))

    def _offsets(self, states: Floats, reading: Ranges) -> tuple[Floats, Floats]:
        places = np.array([self.params.anchors[name] for name in reading.anchors], dtype=np.float64)
        return states[0] - places[:, :1], states[1] - places[:, 1:]
