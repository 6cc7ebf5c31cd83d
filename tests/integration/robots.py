"""A robot that speaks ROS 2 over Zenoh as rmw_zenoh does: it stands in a square room, and loses scans."""

import itertools
import json
import math
import queue
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh
from dynpf_formats.ros2.keys import LATCHED, RELIABLE, SENSOR_DATA, Entity, Published
from dynpf_formats.ros2.types import RosTypes
from dynpf_runtime.bus.processes import free_port
from dynpf_services.ros2.session import RobotSession

__all__ = ["MAP", "ODOMETRY", "POSE", "SCAN", "Messages", "Robot", "live_robot", "robot_at", "router", "router_process"]

SCAN, ODOMETRY, MAP = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "nav_msgs/msg/OccupancyGrid"
POSE, CLOCK = "geometry_msgs/msg/PoseWithCovarianceStamped", "rosgraph_msgs/msg/Clock"
IMU = "sensor_msgs/msg/Imu"
HALF_M, CELL_M = 2.0, 0.1


class Messages:
    """What a robot at a place in a square room says."""

    def __init__(self, types: RosTypes, beams: int = 90, place: tuple[float, float] = (0.3, 0.1)) -> None:
        self._types, self._beams, self._place = types, beams, place

    def _header(self, frame: str, stamp_ns: int):
        stamp = self._types.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self._types.make("std_msgs/msg/Header", stamp, frame)

    def _at(self, x: float, y: float, theta: float = 0.0):
        make = self._types.make
        turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
        return make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", x, y, 0.0), turned)

    def initial_pose(self, x: float, y: float):
        covariance = np.zeros((6, 6))
        covariance[[0, 1, 5], [0, 1, 5]] = 0.0001
        make = self._types.make
        content = make("geometry_msgs/msg/PoseWithCovariance", self._at(x, y), covariance.reshape(-1))
        return make(POSE, self._header("map", 0), content)

    def room(self):
        size = round(2 * HALF_M / CELL_M) + 2
        cells = np.full((size, size), 100, np.int8)
        cells[1:-1, 1:-1] = 0
        origin = self._at(-HALF_M - CELL_M, -HALF_M - CELL_M)
        stamp = self._types.make("builtin_interfaces/msg/Time", 0, 0)
        info = self._types.make("nav_msgs/msg/MapMetaData", stamp, CELL_M, size, size, origin)
        return self._types.make(MAP, self._header("map", 0), info, cells.reshape(-1))

    def scan(self, stamp_ns: int):
        angles = np.linspace(-3.1, 3.1, self._beams)  # none along an axis
        x, y = self._place
        sides = [(wall - x) / np.cos(angles) for wall in (HALF_M, -HALF_M)]
        sides += [(wall - y) / np.sin(angles) for wall in (HALF_M, -HALF_M)]
        ranges = np.min([np.where(side > 0.0, side, np.inf) for side in sides], axis=0).astype(np.float32)
        step = float(angles[1] - angles[0])
        header = self._header("base", stamp_ns)
        span = (float(angles[0]), float(angles[-1]), step, 0.0, 0.05, 0.05, 12.0)
        return self._types.make(SCAN, header, *span, ranges, ranges[:0])

    def imu(self, stamp_ns: int, rate: float):
        """Return what a level IMU says that turns."""
        make, level = self._types.make, self._at(0.0, 0.0).orientation
        zero, rates = (make("geometry_msgs/msg/Vector3", 0.0, 0.0, up) for up in (0.0, rate))
        return make(IMU, self._header("base", stamp_ns), level, np.zeros(9), rates, np.zeros(9), zero, np.zeros(9))

    def pose(self, stamp_ns: int, theta: float = 0.0):
        make = self._types.make
        zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36))
        content = make("geometry_msgs/msg/PoseWithCovariance", self._at(0.0, 0.0, theta), np.zeros(36))
        return make(ODOMETRY, self._header("odom", stamp_ns), "base", content, twist)


class Robot:
    """A robot that stands in a square room; ``heard`` has the messages that others publish, by their topics."""

    def __init__(
        self,
        endpoint: str,
        session: RobotSession,
        types: RosTypes,
        *,
        beams: int = 90,
        lost_every: int = 10,
        namespace: str = "",
        place: tuple[float, float] = (0.3, 0.1),
        simulated: bool = False,
        wire: str = "rmw_zenoh",
        gyro: float | None = None,
    ) -> None:
        self._types, self._session, self._lost_every = types, session, lost_every
        self._namespace, self._simulated = namespace, simulated
        self._says = Messages(types, beams, place)
        self._gyro = gyro  # rad/s that an IMU tells, while the wheels tell next to nothing
        self._origin_ns = time.time_ns() if simulated else 0
        self._told: queue.SimpleQueue[tuple[float, float]] = queue.SimpleQueue()
        self.heard: defaultdict[str, list[tuple[str, bytes, bytes]]] = defaultdict(list)
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        self.ears = zenoh.open(config)
        keys = "0/**" if wire == "rmw_zenoh" else "amcl_pose"
        self._subscriber = self.ears.declare_subscriber(keys, self._hear)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def stop(self) -> None:
        """End the robot."""
        self._over.set()
        self._thread.join()
        self.ears.close()

    def reset(self) -> None:
        """Let the time of a simulated robot begin again."""
        self._origin_ns = time.time_ns()

    def tell(self, x: float, y: float) -> None:
        """Publish where the robot is, as rviz does."""
        self._told.put((x, y))

    def poses(self) -> list[tuple[float, float, float]]:
        """Return time (s), x and y of all the poses that have been heard."""
        found = []
        for kind, payload, _ in list(self.heard[f"{self._namespace}/amcl_pose"]):
            message = self._types.decode(kind, payload)
            stamp, position = message.header.stamp, message.pose.pose.position
            found.append((stamp.sec + stamp.nanosec * 1e-9, position.x, position.y))
        return found

    def entities(self) -> list[Entity]:
        """Return the nodes and endpoints that are there."""
        return list(self._session.entities())

    def _hear(self, sample: zenoh.Sample) -> None:
        key, attachment = str(sample.key_expr), sample.attachment
        if key == "amcl_pose":  # by zenoh-bridge-ros2dds
            self.heard["/amcl_pose"].append((POSE, sample.payload.to_bytes(), b""))
            assert attachment is None
            return
        published = Published.parse(key)
        if published is not None and attachment is not None:
            self.heard[published.topic].append((published.type, sample.payload.to_bytes(), attachment.to_bytes()))

    def _writer(self, topic: str, kind: str, qos=RELIABLE):
        return self._session.writer(Published(self._namespace + topic, kind, self._types.hash(kind)), qos)

    def _drive(self) -> None:
        types = self._types
        scan, odometry = self._writer("/scan", SCAN, SENSOR_DATA), self._writer("/odom", ODOMETRY)
        room = self._writer("/map", MAP, LATCHED)  # before anybody is there to hear it
        room.put(types.encode(MAP, self._says.room()), time.time_ns())
        told = self._writer("/initialpose", POSE)
        clock = self._session.writer(Published("/clock", CLOCK, types.hash(CLOCK)), SENSOR_DATA)
        imu = self._writer("/imu", IMU, SENSOR_DATA)
        for number in itertools.count(1):
            stamp_ns = time.time_ns() - self._origin_ns
            if self._simulated:
                stamp = types.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
                clock.put(types.encode(CLOCK, types.make(CLOCK, stamp)), stamp_ns)
            while not self._told.empty():
                told.put(types.encode(POSE, self._says.initial_pose(*self._told.get())), stamp_ns)
            if self._gyro is not None:
                imu.put(types.encode(IMU, self._says.imu(stamp_ns, self._gyro)), stamp_ns)
            turned = 0.0 if self._gyro is None else 1e-5 * number
            odometry.put(types.encode(ODOMETRY, self._says.pose(stamp_ns, turned)), stamp_ns)
            if number % self._lost_every == 0:
                scan._sequence += 1  # a scan that never comes
            scan.put(types.encode(SCAN, self._says.scan(stamp_ns)), stamp_ns)
            if self._over.wait(0.05):
                return


@contextmanager
def router(endpoint: str) -> Iterator[None]:
    """Be a robot's router."""
    config = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield


@contextmanager
def router_process(endpoint: str) -> Iterator["subprocess.Popen[str]"]:
    """Start a robot's router as a process of its own, which can be killed; it listens when the block begins."""
    code = (
        "import sys; from tests.integration.robots import router\n"
        "with router(sys.argv[1]): print('listens', flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-c", code, endpoint], stdin=pipe, stdout=pipe, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "listens\n"
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def robot_at(endpoint: str, types: RosTypes, **settings: Any) -> Iterator[Robot]:
    """Start a robot at a router; ``settings`` are Robot's."""
    with RobotSession.connect(endpoint, 0, settings.get("namespace", ""), settings.get("wire", "rmw_zenoh")) as session:
        robot = Robot(endpoint, session, types, **settings)
        try:
            yield robot
        finally:
            robot.stop()


@contextmanager
def live_robot(types: RosTypes, **settings: Any) -> Iterator[tuple[str, Robot]]:
    """Start a robot and its router; give the router's endpoint, and the robot. ``settings`` are Robot's."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint), robot_at(endpoint, types, **settings) as robot:
        yield endpoint, robot
