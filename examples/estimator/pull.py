"""An estimator of one's own: odometry, and each landmark in view pulls the pose towards where it would be seen."""

import math
from collections.abc import Iterable
from typing import Annotated, NamedTuple

from dynpf_lab import Message, Moment, Node
from dynpf_protocol.messages import Estimate, LandmarkReadings, Odometry
from msgspec import Meta

from dynpf.portable import atan2, sincos

Share = Annotated[float, Meta(gt=0.0, lt=1.0)]


class Pull(Node, frozen=True, kw_only=True):
    """A complementary filter: no particles, no covariance that means anything."""

    reads = ("sensors/odometry", "sensors/landmarks")
    writes = {"state": Estimate}

    start: tuple[float, float, float]  # m, m, rad
    period: float = 0.1  # s between odometry messages
    share: Share = 0.1  # of what a landmark is off, that its reading takes away

    class State(NamedTuple):
        pose: tuple[float, float, float] | None = None
        twist: tuple[float, float] = (0.0, 0.0)  # m/s and rad/s, until the next is told

    def step(self, state: State, moment: Moment) -> tuple[State, Iterable[Message]]:
        x, y, theta = self.start if state.pose is None else state.pose
        if state.pose is not None:
            (v, w), (sine, cosine) = state.twist, sincos(theta + 0.5 * state.twist[1] * self.period)
            x, y, theta = x + v * self.period * cosine, y + v * self.period * sine, theta + w * self.period
        for readings in moment.all(LandmarkReadings):
            x, y, theta = self._pulled((x, y, theta), readings, moment)
        odometry = moment.newest(Odometry)
        twist = state.twist if odometry is None else (odometry.v, odometry.w)
        theta = math.remainder(theta, math.tau)
        unknown = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01)  # m^2, m rad, rad^2: a guess, and no better
        return state._replace(pose=(x, y, theta), twist=twist), [
            Estimate(x=x, y=y, theta=theta, n_eff=1.0, covariance=unknown)
        ]

    def _pulled(
        self, pose: tuple[float, float, float], readings: LandmarkReadings, moment: Moment
    ) -> tuple[float, float, float]:
        x, y, theta = pose
        places = {mark.id: (mark.x, mark.y) for mark in moment.fact("landmarks")}
        for reading in readings.readings:
            mark_x, mark_y = places[reading.landmark]
            sine, cosine = sincos(theta + reading.bearing)
            x += self.share * (mark_x - reading.range * cosine - x)
            y += self.share * (mark_y - reading.range * sine - y)
            off = atan2(mark_y - y, mark_x - x) - reading.bearing - theta
            theta += self.share * math.remainder(off, math.tau)
        return x, y, theta
