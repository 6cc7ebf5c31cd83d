"""Small ROS bags: a scanner, odometry, transforms, a reference, a cloud and a map."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

__all__ = ["write_bags"]

_STEPS = 6


def write_bags(folder: Path) -> dict[str, Path]:
    """Write the same bag in three formats; return the files by name."""
    folder.mkdir()
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    ros2 = get_typestore(Stores.ROS2_HUMBLE)
    found = {"bag": folder / "one.bag"}
    with Writer1(found["bag"]) as writer:
        _fill(writer, ros1, ros1.serialize_ros1)
    for name, storage in (("mcap", StoragePlugin.MCAP), ("db3", StoragePlugin.SQLITE3)):
        with Writer2(folder / name, version=9, storage_plugin=storage) as writer:
            _fill(writer, ros2, ros2.serialize_cdr)
        found[name] = folder / name / f"{name}.{name}"
    return found


def _fill(writer: Any, store: Any, serialize: Any) -> None:
    connections: dict[str, Any] = {}
    for step in range(_STEPS):
        stamp_ns = 10**9 + step * 10**8
        for topic, message in _messages(store, stamp_ns, 0.1 * step, store.types["std_msgs/msg/Header"]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], stamp_ns, serialize(message, kind))


def _messages(store: Any, stamp_ns: int, x: float, header_type: Any) -> list[tuple[str, Any]]:
    def make(kind: str, **fields: Any) -> Any:
        return store.types[kind](**fields)

    def header(frame: str) -> Any:
        stamp = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        extra = {"seq": 0} if "seq" in header_type.__dataclass_fields__ else {}
        return header_type(stamp=stamp, frame_id=frame, **extra)

    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    turn = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(0.1 * x), w=math.cos(0.1 * x))
    pose = make("geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0), orientation=turn)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    transform = make(
        "geometry_msgs/msg/TransformStamped",
        header=header("base_link"),
        child_frame_id="laser",
        transform=make("geometry_msgs/msg/Transform", translation=zero, rotation=turn),
    )
    odometry = make(
        "nav_msgs/msg/Odometry",
        header=header("odom"),
        child_frame_id="base_link",
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return [
        ("/tf", make("tf2_msgs/msg/TFMessage", transforms=[transform])),
        ("/odom", odometry),
        ("/scan", _scan(make, header("laser"))),
        ("/points", _cloud(make, header("laser"))),
        ("/ground_truth", make("geometry_msgs/msg/PoseStamped", header=header("map"), pose=pose)),
        ("/map", _map(make, header("map"), pose)),
    ]


def _scan(make: Any, header: Any) -> Any:
    return make(
        "sensor_msgs/msg/LaserScan",
        header=header,
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=0.25,
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.1,
        range_max=10.0,
        ranges=np.linspace(1.0, 2.0, 9, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def _cloud(make: Any, header: Any) -> Any:
    points = np.ones((5, 4), dtype="<f4")
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header,
        height=1,
        width=5,
        fields=[
            make("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=7, count=1)
            for place, name in enumerate("xyz")
        ],
        is_bigendian=False,
        point_step=16,
        row_step=80,
        data=points.view(np.uint8).ravel(),
        is_dense=False,
    )


def _map(make: Any, header: Any, pose: Any) -> Any:
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=make("builtin_interfaces/msg/Time", sec=0, nanosec=0),
        resolution=0.1,
        width=8,
        height=6,
        origin=pose,
    )
    return make("nav_msgs/msg/OccupancyGrid", header=header, info=info, data=np.zeros(48, dtype=np.int8))
