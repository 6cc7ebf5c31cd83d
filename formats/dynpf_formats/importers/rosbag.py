"""Importer of ROS bags, 1 and 2: one scanner (or depth camera), odometry, ground truth, static transforms and the map.

A bag may have any number of sensors; a recording has one robot, one scanner, one odometry. Topics that the caller does
not name are chosen by rules, and the summary names them: the scanner with the widest view, and the first by name of
several topics of one kind. Scans keep the scanner's pose on the robot, from the transforms. Records have the stamps of
the message headers and are sorted by them.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState

from dynpf.portable import product
from dynpf.types import FloatArray
from dynpf_formats.importers.bags import Bag, Message, open_bag
from dynpf_formats.importers.clouds import FlattenParams, flatten, points_of
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.maps import map_of_message
from dynpf_formats.importers.ordered import Reorder
from dynpf_formats.importers.poses import Pose, compose, inverse
from dynpf_formats.importers.scans import normalized_scan, scanner_record, without_repeated_scanners
from dynpf_formats.importers.transforms import OPTICAL, TransformTree, matrix, planar
from dynpf_formats.recording.header import Attachment

__all__ = ["BagChoice", "import_rosbag"]

SCANS = "sensor_msgs/msg/LaserScan"
CLOUDS = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
MAPS = "nav_msgs/msg/OccupancyGrid"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", ODOMETRY)
TYPES = (SCANS, CLOUDS, ODOMETRY, MAPS, *TRANSFORMS, *POSES)
TRUE = re.compile(r"truth|ground|(^|[/_])gt([/_]|$)|vicon|mocap|optitrack", re.IGNORECASE)
BASES = ("base_footprint", "base_link", "base")
TF = "tf"
"""The source of odometry if there is no topic for it: the transform from the odometry frame to the base."""

Limits = tuple[float, float]
"""Least and greatest range of a scanner, m."""


class BagChoice(msgspec.Struct, frozen=True, kw_only=True):
    """Which parts of a bag are imported; None lets the importer choose from what there is."""

    scan: str | None = None  # topic of LaserScan or PointCloud2
    odometry: str | None = None  # topic of Odometry, or "tf"
    truth: str | None = None  # topic of poses
    base: str | None = None  # the robot's frame
    odom_frame: str = "odom"  # the frame in which tf gives the robot's pose by odometry
    truth_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad: pose of the map in the truth's frame
    truth_shift: float = 0.0  # s, added to the stamps of the truth
    flatten: FlattenParams = FlattenParams()


class _Plan(NamedTuple):
    """Which topics and frames are read."""

    scan: str
    is_cloud: bool
    odometry: str | None
    truth: str | None
    transforms: tuple[str, ...]
    base: str
    odom_child: str  # the child of the odometry frame in tf
    to_base: Pose  # pose of the base in that frame
    mount: FloatArray  # (4, 4), pose of the scanner on the base
    range_max: float | None  # m, the reading of a beam without return; None: it changes from scan to scan


def import_rosbag(
    path: Path, choice: BagChoice | None = None, *, attachments: tuple[Attachment, ...] = ()
) -> ImportedLog:
    """Return the log in a .bag, .mcap or .db3 file, or in the folder of a ROS 2 bag.

    A map in the bag is attached unless there are ``attachments``. Messages are read as the records are iterated: only
    the index grows with the bag. Raises ImportFailedError if there is nothing to import.
    """
    choice = choice or BagChoice()
    losses = Losses()
    with open_bag(path, TYPES) as bag:
        plan = _planned(bag, choice, losses)
        attachments = attachments or _map(bag, losses)
        x, y, theta = _mount(plan)
        taken = {plan.scan, plan.odometry, plan.truth, *plan.transforms, *bag.of_type(MAPS)}
        settings = {
            "scan": plan.scan,
            "odometry": plan.odometry if plan.odometry != TF else f"tf {choice.odom_frame} -> {plan.odom_child}",
            "truth": plan.truth,
            "base": plan.base,
            "scanner_x_m": x,
            "scanner_y_m": y,
            "scanner_theta_rad": theta,
            "range_max_m": plan.range_max,
            "truth_offset": list(choice.truth_offset),
            "truth_shift_s": choice.truth_shift,
            "topics_left_out": {name: bag.topics[name] for name in sorted(bag.topics.keys() - taken)},
        }
    records = without_repeated_scanners(_records(path, plan, choice, losses))
    return ImportedLog(path.name, "rosbag", settings, records, losses, attachments)


# --- choosing ------------------------------------------------------------------------------------------------------


def _planned(bag: Bag, choice: BagChoice, losses: Losses) -> _Plan:
    scan, frame, range_max = _scanner(bag, choice)
    transforms = tuple(bag.of_type(*TRANSFORMS))
    poses = (topic for topic in bag.of_type(*POSES) if TRUE.search(topic))
    truth = _named(bag, choice.truth, "truth", POSES) or _first(poses)
    odometry = None if choice.odometry == TF else _named(bag, choice.odometry, "odometry", (ODOMETRY,))
    if odometry is None and choice.odometry is None:
        odometry = _first(topic for topic in bag.of_type(ODOMETRY) if topic != truth and not TRUE.search(topic))
    child = _first_child_frame(bag, odometry, losses)
    tree = _tree(bag, transforms, choice, frame, child)
    base = choice.base or _first(name for name in (child, *BASES) if name in tree.frames()) or child or BASES[0]
    mount = tree.find(base, frame)
    if mount is None:
        mount = np.eye(4)
        if "optical" in frame:
            mount[:3, :3] = OPTICAL
        if frame != base:
            losses.add("transforms that the bag lacks, taken as none", f"{base} -> {frame}")
    odom_child, to_base = _odom_child(tree, base, choice.odom_frame)
    if odometry is None and odom_child is not None:
        odometry = TF
    if odometry is None:
        losses.add(
            "odometry, which the bag lacks", f"no {ODOMETRY}, no transform from {choice.odom_frame!r} to {base!r}"
        )
    is_cloud = bag.topics[scan] == CLOUDS
    return _Plan(scan, is_cloud, odometry, truth, transforms, base, odom_child or base, to_base, mount, range_max)


def _first(names: Any) -> str | None:
    return next((name for name in names if name), None)


def _named(bag: Bag, name: str | None, what: str, types: tuple[str, ...]) -> str | None:
    """Return the topic of the given name, or None for none; raises ImportFailedError if the bag has no such topic."""
    if name is None:
        return None
    if bag.topics.get(name) not in types:
        there = ", ".join(bag.of_type(*types)) or "none"
        raise ImportFailedError(f"{bag.path}: no topic {name} for the {what}; the bag has {there}")
    return name


def _scanner(bag: Bag, choice: BagChoice) -> tuple[str, str, float | None]:
    """Return topic, frame and greatest range of the chosen scanner: that with the widest view, then most beams."""
    scan = _named(bag, choice.scan, "scan", (SCANS, CLOUDS))
    found: list[tuple[float, int, str, str, float]] = []
    names = [scan] if scan is not None else bag.of_type(SCANS) or bag.of_type(CLOUDS)
    for name in names:
        first = next(bag.messages([name], Losses()), None)
        if first is not None:
            width, beams = _view(first.content) if bag.topics[name] == SCANS else (0.0, 0)
            greatest = first.content.range_max if bag.topics[name] == SCANS else choice.flatten.range_max
            found.append((-width, -beams, name, _frame(first.content), float(greatest)))
    if not found:
        there = ", ".join(f"{name} ({kind})" for name, kind in sorted(bag.topics.items())[:20]) or "no topics"
        raise ImportFailedError(f"{bag.path}: no {SCANS} and no {CLOUDS} that can be read; it has {there}")
    _, _, name, frame, greatest = min(found)
    return name, frame, greatest if np.isfinite(greatest) and greatest > 0.0 else None


def _view(message: Any) -> tuple[float, int]:
    width = abs(float(message.angle_increment)) * len(message.ranges)
    return (round(width, 3) if np.isfinite(width) else 0.0), len(message.ranges)


def _frame(message: Any) -> str:
    return str(message.header.frame_id).lstrip("/")


def _first_child_frame(bag: Bag, odometry: str | None, losses: Losses) -> str:
    """Return the name of the robot's frame in odometry, or an empty text."""
    first = next(bag.messages([odometry], losses), None) if odometry else None
    return "" if first is None else str(first.content.child_frame_id).lstrip("/")


def _tree(bag: Bag, topics: tuple[str, ...], choice: BagChoice, frame: str, child: str) -> TransformTree:
    """Read transforms until the scanner's pose on the robot, and the robot's in the odometry frame, are known."""
    tree = TransformTree()
    bases = [name for name in (choice.base, child) if name] or list(BASES)
    for message in bag.messages(topics, Losses()):
        for transform in message.content.transforms:
            found = matrix(transform.transform.translation, transform.transform.rotation)
            if found is not None:
                tree.put(_frame(transform), str(transform.child_frame_id).lstrip("/"), found)
        placed = any(tree.find(base, frame) is not None for base in bases)
        if placed and (child or tree.find(choice.odom_frame, frame) is not None):
            break
    return tree


def _odom_child(tree: TransformTree, base: str, odom_frame: str) -> tuple[str | None, Pose]:
    """Return the child of the odometry frame that is an ancestor of the base, and the pose of the base in it."""
    frame: str | None = base
    for _ in range(len(tree.frames())):
        if frame is None or tree.parent(frame) == odom_frame:
            break
        frame = tree.parent(frame)
    if frame is None or tree.parent(frame) != odom_frame:
        return None, (0.0, 0.0, 0.0)
    transform = tree.find(frame, base)
    return frame, (0.0, 0.0, 0.0) if transform is None else planar(transform)


def _mount(plan: _Plan) -> Pose:
    """Return the pose of the scan on the robot, in the plane."""
    if not plan.is_cloud:
        return planar(plan.mount)
    turned = plan.mount.copy()
    if abs(turned[2, 2]) < 0.5:  # its z axis lies flat: an optical frame, which looks along z
        turned[:3, :3] = product(turned[:3, :3], OPTICAL.T)
    return planar(turned)


def _map(bag: Bag, losses: Losses) -> tuple[Attachment, ...]:
    """Return the newest map in the bag as attachments."""
    topics = bag.of_type(MAPS)
    if not topics:
        return ()
    topic = "/map" if "/map" in topics else topics[0]
    found: tuple[Attachment, ...] = ()
    for message in bag.messages([topic], losses):
        try:
            found = map_of_message(message.content, topic.strip("/").replace("/", "_"))
        except ValueError as error:
            losses.add("maps", f"{topic}: {error}")
    return found


# --- reading -------------------------------------------------------------------------------------------------------


def _records(path: Path, plan: _Plan, choice: BagChoice, losses: Losses) -> Iterator[Record]:
    with open_bag(path, TYPES) as bag:
        named = (plan.scan, plan.truth, *(plan.transforms if plan.odometry == TF else (plan.odometry,)))
        topics = sorted({topic for topic in named if topic is not None})
        order = Reorder(losses)
        reader = _Reader(plan, choice, losses)
        for message in bag.messages(topics, losses):
            for records in reader.read(message):
                yield from order.take(records, message.arrival_ns)
        yield from order.rest()


class _Reader:
    """Turns messages into records; records that belong together are one tuple."""

    def __init__(self, plan: _Plan, choice: BagChoice, losses: Losses) -> None:
        self._plan = plan
        self._choice = choice
        self._losses = losses
        self._mount = _mount(plan)
        self._shift_ns = round(choice.truth_shift * 1e9)
        self._to_map = inverse(choice.truth_offset)
        self._last_odometry: Record | None = None

    def read(self, message: Message) -> Iterator[tuple[Record, ...]]:
        """Yield the records of a message."""
        plan, content = self._plan, message.content
        if message.topic in plan.transforms:
            for transform in content.transforms:
                if _frame(transform) == self._choice.odom_frame and _child(transform) == plan.odom_child:
                    body = transform.transform
                    yield from self._odometry(message, transform.header, body.translation, body.rotation, plan.to_base)
            return
        if message.topic == plan.scan:
            yield from self._scan(message)
            return
        pose = content.pose if hasattr(content.pose, "position") else content.pose.pose
        if message.topic == plan.odometry:
            yield from self._odometry(message, content.header, pose.position, pose.orientation, (0.0, 0.0, 0.0))
        else:
            stamp_ns, true_pose = (
                self._stamp(message, content.header),
                self._planar(message, pose.position, pose.orientation),
            )
            if stamp_ns is not None and true_pose is not None:
                x, y, theta = compose(self._to_map, true_pose)
                truth = RobotState(x=x, y=y, theta=theta)
                yield (Record("log/truth", max(stamp_ns + self._shift_ns, 0), truth),)

    def _odometry(
        self, message: Message, header: Any, position: Any, orientation: Any, base: Pose
    ) -> Iterator[tuple[Record, ...]]:
        stamp_ns, pose = self._stamp(message, header), self._planar(message, position, orientation)
        if stamp_ns is None or pose is None:
            return
        x, y, theta = compose(pose, base)
        record = Record("log/odometry_pose", stamp_ns, OdometryPose(x=x, y=y, theta=theta))
        if record == self._last_odometry:
            self._losses.add("repeated odometry", _where(message))
            return
        self._last_odometry = record
        yield (record,)

    def _scan(self, message: Message) -> Iterator[tuple[Record, ...]]:
        stamp_ns = self._stamp(message, message.content.header)
        if stamp_ns is None:
            return
        found = self._flattened(message, stamp_ns) if self._plan.is_cloud else self._laser(message, stamp_ns)
        if found is not None:
            scan, limits = found
            yield scanner_record(stamp_ns, limits), Record("log/scan", stamp_ns, scan)

    def _laser(self, message: Message, stamp_ns: int) -> tuple[LaserScan, Limits] | None:
        content = message.content
        numbers = (content.angle_min, content.angle_increment, content.range_min, content.range_max)
        start, step, least, greatest = (float(number) for number in numbers)
        if not np.isfinite([start, step, least]).all() or not greatest > 0.0:
            self._losses.add("scans without a geometry", f"{_where(message)}: {numbers}")
            return None
        ranges = np.asarray(content.ranges, dtype=np.float64)
        if np.isinf(greatest):  # JSON has no infinity: the farthest return stands for it
            greatest = float(ranges[np.isfinite(ranges)].max(initial=least + 1.0))
        end = start + step * (len(ranges) - 1)
        if self._plan.mount[2, 2] < 0.0:  # the scanner hangs upside down: its left is the robot's right
            start, end = -start, -end
        return self._normalized(stamp_ns, (start, end), ranges, (least, greatest))

    def _flattened(self, message: Message, stamp_ns: int) -> tuple[LaserScan, Limits] | None:
        params = self._choice.flatten
        try:
            points = points_of(message.content)
        except ValueError as error:
            self._losses.add("clouds that cannot be read", f"{_where(message)}: {error}")
            return None
        ranges = flatten(points, self._plan.mount, self._mount, params)
        half = params.field_of_view / 2
        return self._normalized(stamp_ns, (-half, half), ranges, (params.range_min, params.range_max))

    def _normalized(
        self, stamp_ns: int, span: tuple[float, float], ranges: FloatArray, limits: Limits
    ) -> tuple[LaserScan, Limits] | None:
        scan = normalized_scan(stamp_ns, self._mount, span, ranges, limits, losses=self._losses)
        return None if scan is None else (scan, limits)

    def _stamp(self, message: Message, header: Any) -> int | None:
        seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
        if seconds == nanoseconds == 0:
            self._losses.add("stamps of 0, replaced by the time of arrival", _where(message))
            return message.arrival_ns
        if seconds < 0:
            self._losses.add("stamps before 0", _where(message))
            return None
        return seconds * 10**9 + nanoseconds

    def _planar(self, message: Message, position: Any, orientation: Any) -> Pose | None:
        found = matrix(position, orientation)
        if found is None:
            self._losses.add("poses that are not finite numbers", _where(message))
            return None
        return planar(found)


def _child(transform: Any) -> str:
    return str(transform.child_frame_id).lstrip("/")


def _where(message: Message) -> str:
    return f"{message.topic} at {message.arrival_ns * 1e-9:.3f} s"
