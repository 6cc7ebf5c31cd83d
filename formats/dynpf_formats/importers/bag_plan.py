"""Which topics and frames of a ROS bag are read: what the caller names, and for the rest what the bag has."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import takewhile
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np

from dynpf.portable import product
from dynpf.types import FloatArray
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.clouds import FlattenParams
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import Losses
from dynpf_formats.importers.poses import Pose
from dynpf_formats.importers.transforms import OPTICAL, TransformTree, matrix, planar

__all__ = [
    "MAPS",
    "ODOMETRY",
    "SCANS",
    "TF",
    "TRANSFORMS",
    "TYPES",
    "BagChoice",
    "BagPlan",
    "Messages",
    "frame_of",
    "mount_of",
    "planned",
]

SCANS = "sensor_msgs/msg/LaserScan"
CLOUDS = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
MAPS = "nav_msgs/msg/OccupancyGrid"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
LOCALIZED = "amcl_pose"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    WITH_COVARIANCE,
    "geometry_msgs/msg/TransformStamped",
    ODOMETRY,
)
TYPES = (SCANS, CLOUDS, ODOMETRY, MAPS, *TRANSFORMS, *POSES)
TRUE = re.compile(r"truth|ground|(^|[/_])gt([/_]|$)|vicon|mocap|optitrack", re.IGNORECASE)
BASES = ("base_footprint", "base_link", "base")
TF = "tf"
"""The source of odometry if there is no topic for it: the transform from the odometry frame to the base."""


class BagChoice(msgspec.Struct, frozen=True, kw_only=True):
    """Which parts of a bag are imported; None lets the importer choose from what there is."""

    scan: str | None = None  # topic of LaserScan or PointCloud2
    odometry: str | None = None  # topic of Odometry, or "tf"
    truth: str | None = None  # topic of poses
    base: str | None = None  # the robot's frame
    odom_frame: str | None = None  # in which tf gives the robot's pose by odometry; None: odom, named as the scan's is
    truth_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad: pose of the map in the truth's frame
    truth_shift: float = 0.0  # s, added to the stamps of the truth
    flatten: FlattenParams = FlattenParams()


class BagPlan(NamedTuple):
    """Which topics and frames are read."""

    scan: str
    is_cloud: bool
    odometry: str | None
    truth: str | None
    localized: (
        str | None
    )  # topic with the robot's own estimate of its pose in the map; None: map to odom in tf, if at all
    transforms: tuple[str, ...]
    base: str
    odom_frame: str
    odom_child: str  # the child of the odometry frame in tf
    to_base: Pose  # pose of the base in that frame
    mount: FloatArray  # (4, 4), pose of the scanner on the base
    range_max: float | None  # m, the reading of a beam without return; None: it changes from scan to scan


class Messages(Protocol):
    """Messages by their topics: a bag, or what a live robot has said so far. ``path`` is where they come from."""

    topics: dict[str, str]

    @property
    def path(self) -> object:
        """The file, or the endpoint."""

    def of_type(self, *types: str) -> list[str]:
        """Return the topics of the given types, by name."""

    def messages(self, topics: Collection[str], losses: Losses) -> Iterator[Message]:
        """Yield the messages of the given topics in the order of arrival."""


def planned(bag: Messages, choice: BagChoice, losses: Losses) -> BagPlan:
    scan, frame, range_max = _scanner(bag, choice)
    transforms = tuple(bag.of_type(*TRANSFORMS))
    poses = (topic for topic in _nearest(bag.of_type(*POSES), scan) if TRUE.search(topic))
    localized = _first(topic for topic in _nearest(bag.of_type(WITH_COVARIANCE), scan) if topic.endswith(LOCALIZED))
    truth = _named(bag, choice.truth, "truth", POSES) or _first(poses)
    odometry = None if choice.odometry == TF else _named(bag, choice.odometry, "odometry", (ODOMETRY,))
    if odometry is None and choice.odometry is None:
        others = _nearest(bag.of_type(ODOMETRY), scan)
        odometry = _first(topic for topic in others if topic != truth and not TRUE.search(topic))
    child = _first_child_frame(bag, odometry, losses)
    odom_frames = [choice.odom_frame] if choice.odom_frame else _in_namespace(frame, ("odom",))
    usual = _in_namespace(frame, BASES)
    named = [name for name in (choice.base, child) if name]
    tree = _tree(bag.messages(transforms, Losses()), named or usual, frame, () if child else odom_frames)
    bases = (child, *usual)
    base = choice.base or _first(name for name in bases if name in tree.frames()) or child or BASES[0]
    mount = tree.find(base, frame)
    if mount is None:
        mount = np.eye(4)
        if "optical" in frame:
            mount[:3, :3] = OPTICAL
        if frame != base:
            losses.add("transforms that the bag lacks, taken as none", f"{base} -> {frame}")
    odom_frame = _first(name for name in odom_frames if name in tree.frames()) or odom_frames[-1]
    odom_child, to_base = _odom_child(tree, base, odom_frame)
    if odometry is None and odom_child is not None:
        odometry = TF
    if odometry is None:
        losses.add("odometry, which the bag lacks", f"no {ODOMETRY}, no transform from {odom_frame!r} to {base!r}")
    is_cloud = bag.topics[scan] == CLOUDS
    return BagPlan(
        scan,
        is_cloud,
        odometry,
        truth,
        localized if localized != truth else None,
        transforms,
        base,
        odom_frame,
        odom_child or base,
        to_base,
        mount,
        range_max,
    )


def _in_namespace(frame: str, names: Sequence[str]) -> list[str]:
    """Return frames of the same robot as ``frame``: ``robot1/laser`` has ``robot1/odom``, and then perhaps ``odom``."""
    namespace, slash, _ = frame.rpartition("/")
    return [*(f"{namespace}{slash}{name}" for name in names if slash), *names]


def _nearest(topics: Sequence[str], scan: str) -> list[str]:
    """Return topics by how much of their namespace they share with the scan, then by name."""

    def shared(topic: str) -> int:
        pairs = zip(topic.split("/")[:-1], scan.split("/")[:-1], strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

    return sorted(topics, key=lambda topic: (-shared(topic), topic))


def _first(names: Any) -> str | None:
    return next((name for name in names if name), None)


def _named(bag: Messages, name: str | None, what: str, types: tuple[str, ...]) -> str | None:
    """Return the topic of the given name, or None for none; raises ImportFailedError if the bag has no such topic."""
    if name is None:
        return None
    if bag.topics.get(name) not in types:
        there = ", ".join(bag.of_type(*types)) or "none"
        raise ImportFailedError(f"{bag.path}: no topic {name} for the {what}; the bag has {there}")
    return name


def _scanner(bag: Messages, choice: BagChoice) -> tuple[str, str, float | None]:
    """Return topic, frame and greatest range of the chosen scanner: that with the widest view, then most beams."""
    scan = _named(bag, choice.scan, "scan", (SCANS, CLOUDS))
    found: list[tuple[float, int, str, str, float]] = []
    names = [scan] if scan is not None else bag.of_type(SCANS) or bag.of_type(CLOUDS)
    for name in names:
        first = next(bag.messages([name], Losses()), None)
        if first is not None:
            width, beams = _view(first.content) if bag.topics[name] == SCANS else (0.0, 0)
            greatest = first.content.range_max if bag.topics[name] == SCANS else choice.flatten.range_max
            found.append((-width, -beams, name, frame_of(first.content), float(greatest)))
    if not found:
        there = ", ".join(f"{name} ({kind})" for name, kind in sorted(bag.topics.items())[:20]) or "no topics"
        raise ImportFailedError(f"{bag.path}: no {SCANS} and no {CLOUDS} that can be read; it has {there}")
    _, _, name, frame, greatest = min(found)
    return name, frame, greatest if np.isfinite(greatest) and greatest > 0.0 else None


def _view(message: Any) -> tuple[float, int]:
    width = abs(float(message.angle_increment)) * len(message.ranges)
    return (round(width, 3) if np.isfinite(width) else 0.0), len(message.ranges)


def frame_of(message: Any) -> str:
    return str(message.header.frame_id).lstrip("/")


def _first_child_frame(bag: Messages, odometry: str | None, losses: Losses) -> str:
    """Return the name of the robot's frame in odometry, or an empty text."""
    first = next(bag.messages([odometry], losses), None) if odometry else None
    return "" if first is None else str(first.content.child_frame_id).lstrip("/")


def _tree(messages: Iterable[Message], bases: Sequence[str], frame: str, odom_frames: Sequence[str]) -> TransformTree:
    """Read transforms until the scanner's pose on the robot, and the robot's in the odometry frame, are known."""
    tree = TransformTree()
    for message in messages:
        for transform in message.content.transforms:
            found = matrix(transform.transform.translation, transform.transform.rotation)
            if found is not None:
                tree.put(frame_of(transform), str(transform.child_frame_id).lstrip("/"), found)
        if all(any(tree.find(name, frame) is not None for name in names) for names in (bases, odom_frames) if names):
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


def mount_of(plan: BagPlan) -> Pose:
    """Return the pose of the scan on the robot, in the plane."""
    if not plan.is_cloud:
        return planar(plan.mount)
    turned = plan.mount.copy()
    if abs(turned[2, 2]) < 0.5:  # its z axis lies flat: an optical frame, which looks along z
        turned[:3, :3] = product(turned[:3, :3], OPTICAL.T)
    return planar(turned)
