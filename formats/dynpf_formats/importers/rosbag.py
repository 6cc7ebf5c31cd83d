"""Importer of ROS bags, 1 and 2: one scanner (or depth camera), odometry, ground truth, static transforms and the map.

A bag may have any number of sensors; a recording has one robot, one scanner, one odometry. Topics that the caller does
not name are chosen by rules, and the summary names them: the scanner with the widest view, and the first by name of
several topics of one kind. Scans keep the scanner's pose on the robot, from the transforms. Records have the stamps of
the message headers and are sorted by them.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState

from dynpf.types import FloatArray
from dynpf_formats.importers.bag_plan import MAPS, TF, TYPES, BagChoice, BagPlan, frame_of, mount_of, planned
from dynpf_formats.importers.bags import Bag, Message, open_bag
from dynpf_formats.importers.clouds import flatten, points_of
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.maps import map_of_message
from dynpf_formats.importers.ordered import Reorder
from dynpf_formats.importers.poses import Pose, compose, inverse
from dynpf_formats.importers.scans import normalized_scan, scanner_record, without_repeated_scanners
from dynpf_formats.importers.transforms import matrix, planar
from dynpf_formats.recording.header import Attachment

__all__ = ["BagChoice", "RecordReader", "import_rosbag"]

NO_RETURN_M = 100.0
"""What a beam without return reads if the scanner's greatest range is infinite, unless a return is farther."""

MAP_FRAME = "map"

Limits = tuple[float, float]
"""Least and greatest range of a scanner, m."""


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
        plan = planned(bag, choice, losses)
        attachments = attachments or _map(bag, losses)
        x, y, theta = mount_of(plan)
        taken = {plan.scan, plan.odometry, plan.truth, plan.localized, *plan.transforms, *bag.of_type(MAPS)}
        settings = {
            "scan": plan.scan,
            "odometry": plan.odometry if plan.odometry != TF else f"tf {plan.odom_frame} -> {plan.odom_child}",
            "truth": plan.truth,
            **({} if plan.localized is None else {"localized": plan.localized}),
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


def _records(path: Path, plan: BagPlan, choice: BagChoice, losses: Losses) -> Iterator[Record]:
    with open_bag(path, TYPES) as bag:
        named = (plan.scan, plan.truth, plan.localized, plan.odometry, *plan.transforms)
        topics = sorted({topic for topic in named if topic is not None and topic != TF})
        order = Reorder(losses)
        reader = RecordReader(plan, choice, losses)
        for message in bag.messages(topics, losses):
            for records in reader.read(message):
                yield from order.take(records, message.arrival_ns)
        yield from order.rest()


class RecordReader:
    """Turns messages into records; records that belong together are one tuple."""

    def __init__(self, plan: BagPlan, choice: BagChoice, losses: Losses) -> None:
        self._plan = plan
        self._choice = choice
        self._losses = losses
        self._mount = mount_of(plan)
        self._shift_ns = round(choice.truth_shift * 1e9)
        self._to_map = inverse(choice.truth_offset)
        self._last_odometry: Record | None = None
        self._odom_in_map = _Corrections()

    def read(self, message: Message) -> Iterator[tuple[Record, ...]]:
        """Yield the records of a message."""
        plan, content = self._plan, message.content
        if message.topic in plan.transforms:
            for transform in content.transforms:
                if _child(transform) == plan.odom_frame and plan.localized is None:
                    self._odom_in_map.take(transform)
                of_base = frame_of(transform) == plan.odom_frame and _child(transform) == plan.odom_child
                if plan.odometry == TF and of_base:
                    body = transform.transform
                    yield from self._odometry(message, transform.header, body.translation, body.rotation, plan.to_base)
            return
        if message.topic == plan.scan:
            yield from self._scan(message)
            return
        position, orientation = _position_and_orientation(content)
        if message.topic == plan.odometry:
            yield from self._odometry(message, content.header, position, orientation, (0.0, 0.0, 0.0))
        else:
            stamp_ns, pose = self._stamp(message, content.header), self._planar(message, position, orientation)
            if stamp_ns is None or pose is None:
                return
            if message.topic == plan.localized:
                yield (_localized(stamp_ns, pose),)
            else:
                x, y, theta = compose(self._to_map, pose)
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
        corrected = self._odom_in_map.corrected((x, y, theta))
        yield (record,) if corrected is None else (record, _localized(stamp_ns, corrected))

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
        ranges = np.asarray(content.ranges, dtype=np.float64)
        if step == 0.0 and len(ranges) > 1:  # then the last beam's angle says it
            step = (float(content.angle_max) - start) / (len(ranges) - 1)
        if not np.isfinite([start, step, least]).all() or not greatest > 0.0 or (step == 0.0 and len(ranges) > 1):
            self._losses.add("scans without a geometry", f"{_where(message)}: {numbers}")
            return None
        if np.isinf(greatest):  # JSON has no infinity; no return is as far as this
            greatest = max(NO_RETURN_M, 2.0 * float(ranges[np.isfinite(ranges)].max(initial=0.0)))
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
            numbers = [position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w]
            finite = bool(np.isfinite(numbers).all())
            reason = "poses whose quaternion has no length" if finite else "poses that are not finite numbers"
            self._losses.add(reason, _where(message))
            return None
        return planar(found)


class _Corrections:
    """The transform from map to odom, by which a localization corrects odometry; one that never changes is none."""

    def __init__(self) -> None:
        self._first: Pose | None = None
        self._newest: Pose | None = None

    def take(self, transform: Any) -> None:
        """Take a transform to the odometry's frame."""
        found = matrix(transform.transform.translation, transform.transform.rotation)
        if found is not None and frame_of(transform).rpartition("/")[2] == MAP_FRAME:
            pose = planar(found)
            self._first = self._first or pose
            self._newest = pose if pose != self._first else self._newest

    def corrected(self, pose: Pose) -> Pose | None:
        """Return a pose by odometry as it is in the map, or None while nothing has been corrected."""
        return None if self._newest is None else compose(self._newest, pose)


def _localized(stamp_ns: int, pose: Pose) -> Record:
    x, y, theta = pose
    return Record("log/localized", stamp_ns, RobotState(x=x, y=y, theta=theta))


def _position_and_orientation(content: Any) -> tuple[Any, Any]:
    """Return those of a message with a pose, of whichever type."""
    if hasattr(content, "transform"):
        return content.transform.translation, content.transform.rotation
    pose = content.pose if hasattr(content.pose, "position") else content.pose.pose
    return pose.position, pose.orientation


def _child(transform: Any) -> str:
    return str(transform.child_frame_id).lstrip("/")


def _where(message: Message) -> str:
    return f"{message.topic} at {message.arrival_ns * 1e-9:.3f} s"
