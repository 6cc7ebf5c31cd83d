"""What one update of the room scenarios' filters costs at N particles: between two scans, odometry included.

Usage: python benchmarks/room_update.py [N]
The best of twelve for each of forty updates of a drive; printed are their median and the worst, in milliseconds.
"""

import sys
import time
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from dynpf_protocol.messages import LaserScan
from dynpf_systems.rooms.localization.components import localizer_of, measurements_of, motion_of
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.readings import TOPICS, reading_of
from dynpf_systems.rooms.studies.ways import Epoch, World, known_start, load_world, record

from dynpf.filters.start import start_poses
from dynpf.measurement.model import MeasurementModel
from dynpf.rng import Stream

REPEATS, UPDATES = 12, 40


def main(n: int) -> None:
    for name in ("indoor-tracking", "turtlebot-room", "turtlebot-loops"):
        world = load_world(name)
        epochs = record(world, 1, UPDATES).epochs
        estimator = world.scenario.estimator
        assert isinstance(estimator, LocalizationConfig)
        config = msgspec.structs.replace(estimator, n=n, start=known_start(epochs, 1, 0.2, 0.1))
        motion, models = motion_of(config, world.maps, {}), measurements_of(config, world.maps, {})
        localizer = localizer_of(config, motion.model, models, world.maps, {})
        belief = localizer.start(start_poses(config.start, n, Stream.of(1, "bench", 0)), Stream.of(1, "bench", 1))
        costs = []
        for number, epoch in enumerate(epochs[1:], start=1):
            taken, stream = [], Stream.of(1, "bench", number)
            readings = _readings(world, epoch, models)
            for _ in range(REPEATS):
                began, after = time.perf_counter(), belief
                for part, held in enumerate(epoch.controls[:-1]):
                    after = localizer.predict(after, motion.control(held), stream.part(part))
                after, _ = localizer.update(after, motion.control(epoch.controls[-1]), readings, stream)
                taken.append(time.perf_counter() - began)
            belief = after
            costs.append(1e3 * min(taken))
        print(f"{name:<16} N = {n}: median {np.median(costs):.2f} ms, worst {max(costs):.2f} ms")


def _readings(world: World, epoch: Epoch, models: Mapping[type, MeasurementModel[Any]]) -> list[Any]:
    """Return what was seen at the end of an epoch as the readings that measurement models take."""
    kinds = {TOPICS[kind]: kind for kind in models}
    seen = [("sensors/scan" if isinstance(one, LaserScan) else "sensors/landmarks", one) for one in epoch.messages]
    return [reading_of(message, kinds[topic], world.scanner) for topic, message in seen if topic in kinds]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5000)
