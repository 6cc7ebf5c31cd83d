"""Small ROS bags of known content, in every format, and a reader of ROS 1 bags that shares nothing with the library."""

import bz2
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
ROS2 = get_typestore(Stores.ROS2_HUMBLE)

Said = tuple[str, int, Callable[["Maker"], Any]]
"""Topic, time of arrival in ns, and what makes the message."""


class Maker:
    """Messages in the types of one version of ROS."""

    def __init__(self, store: Any) -> None:
        self.types = store.types
        self.store = store

    def __call__(self, kind: str, /, **fields: Any) -> Any:
        return self.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        fields = {"stamp": stamp, "frame_id": frame}
        return self("std_msgs/msg/Header", **fields, **({"seq": 0} if self.store is ROS1 else {}))

    def pose(self, x: float, y: float, q: Sequence[float]) -> Any:
        position = self("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        return self("geometry_msgs/msg/Pose", position=position, orientation=self.quaternion(q))

    def quaternion(self, q: Sequence[float]) -> Any:
        return self("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])


def yaw(angle: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, float(np.sin(angle / 2)), float(np.cos(angle / 2))


def scan(stamp_ns: int, ranges: Sequence[float], frame: str = "laser", **changes: float) -> Callable[[Maker], Any]:
    geometry = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "range_min": 0.1, "range_max": 10.0}
    return lambda make: make(
        "sensor_msgs/msg/LaserScan",
        header=make.header(stamp_ns, frame),
        time_increment=0.0,
        scan_time=0.0,
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
        **{**geometry, **changes},
    )


def odometry(stamp_ns: int, x: float, y: float, theta: float, child: str = "base_link") -> Callable[[Maker], Any]:
    def message(make: Maker) -> Any:
        zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        return make(
            "nav_msgs/msg/Odometry",
            header=make.header(stamp_ns, "odom"),
            child_frame_id=child,
            pose=make(
                "geometry_msgs/msg/PoseWithCovariance", pose=make.pose(x, y, yaw(theta)), covariance=np.zeros(36)
            ),
            twist=make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )

    return message


def pose(stamp_ns: int, x: float, y: float, q: Sequence[float]) -> Callable[[Maker], Any]:
    return lambda make: make(
        "geometry_msgs/msg/PoseStamped", header=make.header(stamp_ns, "map"), pose=make.pose(x, y, q)
    )


def transform(
    stamp_ns: int, parent: str, child: str, place: Sequence[float], q: Sequence[float] = (0, 0, 0, 1)
) -> Callable[[Maker], Any]:
    def message(make: Maker) -> Any:
        body = make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", x=place[0], y=place[1], z=place[2]),
            rotation=make.quaternion([float(one) for one in q]),
        )
        stamped = make(
            "geometry_msgs/msg/TransformStamped",
            header=make.header(stamp_ns, parent),
            child_frame_id=child,
            transform=body,
        )
        return make("tf2_msgs/msg/TFMessage", transforms=[stamped])

    return message


def grid(cells: Sequence[Sequence[int]], resolution: float, x: float, y: float, theta: float) -> Callable[[Maker], Any]:
    def message(make: Maker) -> Any:
        time = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
        info = make(
            "nav_msgs/msg/MapMetaData",
            map_load_time=time,
            resolution=resolution,
            width=len(cells[0]),
            height=len(cells),
            origin=make.pose(x, y, yaw(theta)),
        )
        data = np.array(cells, dtype=np.int8).ravel()
        return make("nav_msgs/msg/OccupancyGrid", header=make.header(1, "map"), info=info, data=data)

    return message


def cloud(stamp_ns: int, points: Sequence[Sequence[float]], frame: str) -> Callable[[Maker], Any]:
    def message(make: Maker) -> Any:
        fields = [
            make("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=7, count=1)
            for place, name in enumerate("xyz")
        ]
        data = np.zeros((len(points), 4), dtype="<f4")  # with four bytes of padding each
        data[:, :3] = points
        return make(
            "sensor_msgs/msg/PointCloud2",
            header=make.header(stamp_ns, frame),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=16,
            row_step=16 * len(points),
            data=data.view(np.uint8).ravel(),
            is_dense=False,
        )

    return message


def write_ros1(path: Path, said: Sequence[Said], compression: Any = None) -> Path:
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {}
        for topic, arrival_ns, message in said:
            made = message(Maker(ROS1))
            kind = made.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], arrival_ns, ROS1.serialize_ros1(made, kind))
    return path


def write_ros2(path: Path, said: Sequence[Said], storage: StoragePlugin) -> Path:
    with Writer2(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, arrival_ns, message in said:
            made = message(Maker(ROS2))
            kind = made.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], arrival_ns, ROS2.serialize_cdr(made, kind))
    return path


def raw_messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield topic and payload of every message of a ROS 1 bag, in file order, from the bytes alone (format 2.0)."""
    data = path.read_bytes()
    assert data.startswith(b"#ROSBAG V2.0\n")
    yield from _records(data[13:], {})


def _records(data: bytes, topics: dict[int, str]) -> Iterator[tuple[str, bytes]]:
    place = 0
    while place < len(data):
        header, place = _sized(data, place)
        body, place = _sized(data, place)
        fields = _fields(header)
        match fields[b"op"][0]:
            case 5:
                unpack = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}
                yield from _records(unpack[fields[b"compression"]](body), topics)
            case 7:
                topics[struct.unpack("<I", fields[b"conn"])[0]] = fields[b"topic"].decode()
            case 2:
                yield topics[struct.unpack("<I", fields[b"conn"])[0]], body


def _sized(data: bytes, place: int) -> tuple[bytes, int]:
    (size,) = struct.unpack_from("<I", data, place)
    return data[place + 4 : place + 4 + size], place + 4 + size


def _fields(header: bytes) -> dict[bytes, bytes]:
    found, place = {}, 0
    while place < len(header):
        field, place = _sized(header, place)
        name, _, value = field.partition(b"=")
        found[name] = value
    return found
