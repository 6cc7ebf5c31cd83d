"""What a robot says at first, from which follows what of it is heard: scanner, odometry, frames, and its map."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from dynpf_formats.importers.bag_plan import MAPS, ODOMETRY, SCANS, TF, TRANSFORMS, BagChoice, frame_of, planned
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Losses
from dynpf_formats.importers.maps import map_of_message
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.importers.scans import without_repeated_scanners
from dynpf_formats.ros2.attachment import BadAttachmentError
from dynpf_formats.ros2.keys import NO_HASH, Entity
from dynpf_formats.ros2.robot import IMU, Heard, LiveReader, RobotPlan, Said, opened
from dynpf_formats.ros2.types import BadRosMessageError, RosTypes
from dynpf_protocol.errors import RunError

from dynpf_services.ros2.bridge import Bridge
from dynpf_services.ros2.reach import Reach, Session

__all__ = ["look_at_robot"]

_LEAST_S = 1.0  # so that all that is latched has come
_POLL_S = 0.02
_MOST_MESSAGES = 5000
_TF = TRANSFORMS[0]


def look_at_robot(
    bridge: Callable[[RobotPlan, bool], Bridge],
    reach: Reach,
    namespace: str,
    choice: BagChoice,
    *,
    imu: str | None,
    patience_s: float,
    log: Path,
    stopped: Callable[[], bool],
) -> Bridge:
    """Hear a robot until its scanner, odometry and map are known, and write what it has said so far to ``log``.

    That is an imported log like any other: a scenario takes its map. Raises RunError if nothing of a scanner has come
    in ``patience_s``, KeyboardInterrupt once ``stopped`` returns true.
    """
    types, said, losses, where = RosTypes(), Said(reach.where), Losses(), reach.where
    heard: list[Heard] = []
    refused: list[str] = []
    with reach.session(namespace) as session:
        _listen(session, namespace, imu)
        began = time.monotonic()
        while not _enough(said, choice, imu, session, time.monotonic() - began):
            if stopped():
                raise KeyboardInterrupt
            if time.monotonic() - began > patience_s or len(heard) > _MOST_MESSAGES:
                break
            _hear(session, types, said, heard, refused)
            time.sleep(_POLL_S)
        entities = session.entities()
    if not said.of_type(SCANS):
        raise RunError(_nothing(where, namespace, entities, said, refused))
    plan = planned(said, choice, losses)
    robot = RobotPlan.of(plan, said.odom_frame(plan), said.topics, namespace)
    if imu is not None:
        robot = _with_imu(robot, imu, said, losses)
    reader = LiveReader(robot, types)
    records = [record for one in heard for record in reader.take(one).records]
    name, content = "map", said.map()
    try:
        attachments = () if content is None else map_of_message(content, name)
    except ValueError as error:
        raise ImportFailedError(f"{where}: the robot's map: {error}") from error
    settings = {"scan": plan.scan, "odometry": plan.odometry, "base": plan.base, "odom_frame": robot.odom_frame}
    settings |= {} if imu is None else {"imu": imu}
    write_recording(ImportedLog(where, "ros2", settings, without_repeated_scanners(records), losses, attachments), log)
    hashes = {entity.published.hash for entity in entities if entity.published is not None and entity.kind == "MP"}
    return bridge(robot, hashes == {NO_HASH})


def _listen(session: Session, namespace: str, imu: str | None) -> None:
    """Hear whatever there may be to choose from."""
    within = f"{namespace.strip('/')}/" if namespace else ""
    for kind in (SCANS, ODOMETRY):
        session.hear(f"{within}**", kind)
    for kind in (MAPS, _TF):
        session.hear(f"{within}**", kind, latched=True)
    if namespace:  # what robots share
        session.hear("map", MAPS, latched=True)
        session.hear("*", _TF, latched=True)
    if imu is not None:
        session.hear(imu.strip("/"), IMU)


def _hear(session: Session, types: RosTypes, said: Said, heard: list[Heard], refused: list[str]) -> None:
    while (one := session.take()) is not None:
        try:
            published, _, content = opened(one, types)
        except (BadAttachmentError, BadRosMessageError) as error:
            refused.append(str(error))
            continue
        said.add(published.type, Message(published.topic, one.arrival_ns, content))
        if published.type != MAPS:
            heard.append(one)


def _with_imu(robot: RobotPlan, imu: str, said: Said, losses: Losses) -> RobotPlan:
    """Return the plan with a gyro; raises RunError if there is none, or no odometry that it could turn."""
    first = next(said.messages({imu}, losses), None)
    if first is None or said.topics[imu] != IMU:
        raise RunError(f"--imu {imu}: no {IMU} has come; those there are: {', '.join(said.of_type(IMU)) or 'none'}")
    if robot.odometry is None:
        raise RunError(f"--imu {imu}: there is no odometry that it could turn")
    frame = frame_of(first.content)
    axis = said.vertical_of(frame, robot.base)
    if axis is None and frame != robot.base:
        losses.add("transforms that the robot lacks, taken as none", f"{robot.base} -> {frame}")
    return robot.with_imu(imu, axis or (0.0, 0.0, 1.0))


def _enough(said: Said, choice: BagChoice, imu: str | None, session: Session, waited_s: float) -> bool:
    """Return whether scanner, odometry and gyro are known, and the map if the robot has one."""
    if waited_s < _LEAST_S or not said.of_type(SCANS) or not (said.of_type(ODOMETRY) or said.of_type(_TF)):
        return False
    if (choice.odometry == TF and not said.of_type(_TF)) or (imu is not None and imu not in said.topics):
        return False
    maps = any(
        one.published is not None and one.kind == "MP" and one.published.type == MAPS for one in session.entities()
    )
    return not maps or bool(said.of_type(MAPS))


def _nothing(where: str, namespace: str, entities: Sequence[Entity], said: Said, refused: list[str]) -> str:
    """Return why there is no scan, as far as it is known."""
    there = sorted({one.published.topic for one in entities if one.published is not None and one.kind == "MP"})
    shown = ", ".join(there[:20]) or "none: is it the robot's domain, --domain?"
    text = f"{where}: no {SCANS} has come from {namespace or 'the robot'}; its topics are {shown}"
    if refused:
        text += f"; refused {len(refused)} messages, the first: {refused[0]}"
    if said.topics:
        text += f"; heard {', '.join(sorted(said.topics))}"
    return text
