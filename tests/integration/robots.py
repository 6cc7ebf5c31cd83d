"""A robot that speaks ROS 2 over Zenoh as rmw_zenoh does: it stands in a square room, and loses scans."""

import itertools
import json
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import zenoh
from dynpf_formats.ros2.keys import LATCHED, RELIABLE, SENSOR_DATA, Entity, Published
from dynpf_formats.ros2.types import RosTypes
from dynpf_runtime.bus.processes import free_port
from dynpf_services.ros2.session import RobotSession

__all__ = ["MAP", "ODOMETRY", "SCAN", "Robot", "live_robot", "router"]

SCAN, ODOMETRY, MAP = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "nav_msgs/msg/OccupancyGrid"
HALF_M, CELL_M = 2.0, 0.1


class Robot:
    """A robot that stands in a square room; ``heard`` has the messages that others publish, by their topics."""

    def __init__(self, endpoint: str, session: RobotSession, types: RosTypes, *, beams: int, lost_every: int) -> None:
        self._types, self._session, self._beams, self._lost_every = types, session, beams, lost_every
        self.heard: defaultdict[str, list[tuple[str, bytes, bytes]]] = defaultdict(list)
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        self.ears = zenoh.open(config)
        self._subscriber = self.ears.declare_subscriber("0/**", self._hear)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def stop(self) -> None:
        """End the robot."""
        self._over.set()
        self._thread.join()
        self.ears.close()

    def entities(self) -> list[Entity]:
        """Return the nodes and endpoints that are there."""
        return list(self._session.entities())

    def _hear(self, sample: zenoh.Sample) -> None:
        key, attachment = str(sample.key_expr), sample.attachment
        published = Published.parse(key)
        if published is not None and attachment is not None:
            self.heard[published.topic].append((published.type, sample.payload.to_bytes(), attachment.to_bytes()))

    def _writer(self, topic: str, kind: str, qos=RELIABLE):
        return self._session.writer(Published(topic, kind, self._types.hash(kind)), qos)

    def _drive(self) -> None:
        types = self._types
        scan, odometry = self._writer("/scan", SCAN, SENSOR_DATA), self._writer("/odom", ODOMETRY)
        room = self._writer("/map", MAP, LATCHED)  # before anybody is there to hear it
        room.put(types.encode(MAP, self._room()), time.time_ns())
        for number in itertools.count(1):
            stamp_ns = time.time_ns()
            odometry.put(types.encode(ODOMETRY, self._pose(stamp_ns)), stamp_ns)
            if number % self._lost_every == 0:
                scan._sequence += 1  # a scan that never comes
            scan.put(types.encode(SCAN, self._scan(stamp_ns)), stamp_ns)
            if self._over.wait(0.05):
                return

    def _header(self, frame: str, stamp_ns: int):
        stamp = self._types.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self._types.make("std_msgs/msg/Header", stamp, frame)

    def _at(self, x: float, y: float):
        make = self._types.make
        turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        return make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", x, y, 0.0), turned)

    def _room(self):
        size = round(2 * HALF_M / CELL_M) + 2
        cells = np.full((size, size), 100, np.int8)
        cells[1:-1, 1:-1] = 0
        origin = self._at(-HALF_M - CELL_M, -HALF_M - CELL_M)
        stamp = self._types.make("builtin_interfaces/msg/Time", 0, 0)
        info = self._types.make("nav_msgs/msg/MapMetaData", stamp, CELL_M, size, size, origin)
        return self._types.make(MAP, self._header("map", 0), info, cells.reshape(-1))

    def _scan(self, stamp_ns: int):
        angles = np.linspace(-3.1, 3.1, self._beams)  # none along an axis
        sides = [(wall - 0.3) / np.cos(angles) for wall in (HALF_M, -HALF_M)]
        sides += [(wall - 0.1) / np.sin(angles) for wall in (HALF_M, -HALF_M)]
        ranges = np.min([np.where(side > 0.0, side, np.inf) for side in sides], axis=0).astype(np.float32)
        step = float(angles[1] - angles[0])
        header = self._header("base", stamp_ns)
        span = (float(angles[0]), float(angles[-1]), step, 0.0, 0.05, 0.05, 12.0)
        return self._types.make(SCAN, header, *span, ranges, ranges[:0])

    def _pose(self, stamp_ns: int):
        make = self._types.make
        zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36))
        content = make("geometry_msgs/msg/PoseWithCovariance", self._at(0.0, 0.0), np.zeros(36))
        return make(ODOMETRY, self._header("odom", stamp_ns), "base", content, twist)


@contextmanager
def router(endpoint: str) -> Iterator[None]:
    """Be a robot's router."""
    config = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield


@contextmanager
def live_robot(types: RosTypes, *, beams: int = 90, lost_every: int = 10) -> Iterator[tuple[str, Robot]]:
    """Start a robot that loses one in so many scans, and its router; give the router's endpoint, and the robot."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint), RobotSession.connect(endpoint, 0, "/") as session:
        robot = Robot(endpoint, session, types, beams=beams, lost_every=lost_every)
        try:
            yield endpoint, robot
        finally:
            robot.stop()
