"""A run as a recording of Rerun: its own archetypes, and every number as a line of a plot."""

import base64
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rerun as rr
from dynpf_protocol.messages import (
    CompressedImage,
    FrameTransforms,
    Log,
    Pose,
    PoseInFrame,
    PosesInFrame,
    SceneUpdate,
)

from dynpf_experiments.viewers.items import Item, Number, Plain
from dynpf_experiments.viewers.shapes import PointCloud

__all__ = ["write_rerun"]

TIMELINE = "time"
_ARROW_M = 0.15
_LEVELS = ("TRACE", "DEBUG", "INFO", "WARN", "ERROR", "CRITICAL")


def write_rerun(shown: Iterable[Item], path: Path, *, name: str, digest: str) -> int:
    """Write a file with what viewers are shown, and return the number of messages that Rerun has something for.

    ``name`` is what Rerun calls the run, ``digest`` tells recordings apart.
    """
    stream = rr.RecordingStream("dynpf", recording_id=digest)
    stream.save(path)
    stream.send_recording_name(name)
    count = 0
    begin_ns: int | None = None
    for item in shown:
        begin_ns = item.stamp_ns if begin_ns is None else begin_ns
        archetypes = _archetypes(item.shown)
        if archetypes:
            stream.set_time(TIMELINE, duration=(item.stamp_ns - begin_ns) * 1e-9)
            for suffix, archetype in archetypes.items():
                stream.log(f"{item.topic}{suffix}", archetype)
            count += 1
    stream.flush()
    stream.disconnect()
    return count


def _archetypes(shown: Any) -> dict[str, Any]:
    """Return what Rerun shows for an item, by what is added to its topic."""
    match shown:
        case Number(value=value):
            return {"": rr.Scalars(value)}
        case Plain(data=data, schema=None):
            return {f"/{name}": rr.Scalars(value) for name, value in msgspec.json.decode(data).items()}
        case CompressedImage(data=data, format=form):
            return {"": rr.EncodedImage(contents=_bytes(data), media_type=f"image/{form}")}
        case PoseInFrame(pose=pose):
            return {"": _arrows((pose,))}
        case PosesInFrame(poses=poses):
            return {"": _arrows(poses)}
        case PointCloud(data=data):
            return {"": rr.Points3D(np.frombuffer(data, dtype="<f4").reshape(-1, 3))}
        case FrameTransforms(transforms=transforms):
            return {f"/{each.child_frame_id}": _transform(each) for each in transforms}
        case SceneUpdate():
            return _lines(shown)
        case Log(message=message, level=level):
            return {"": rr.TextLog(message, level=_LEVELS[int(level)])}
    return {}


def _bytes(data: bytes | str) -> bytes:
    return base64.b64decode(data) if isinstance(data, str) else data


def _arrows(poses: Iterable[Pose]) -> Any:
    table = np.array(
        [(each.position.x, each.position.y, each.orientation.z, each.orientation.w) for each in poses]
    ).reshape(-1, 4)
    x, y, z, w = table.T
    flat = np.zeros_like(x)
    ahead = _ARROW_M * np.stack([1.0 - 2.0 * z * z, 2.0 * z * w, flat], axis=1)
    return rr.Arrows3D(origins=np.stack([x, y, flat], axis=1), vectors=ahead)


def _transform(each: Any) -> Any:
    at, turn = each.translation, each.rotation
    return rr.Transform3D(
        translation=[at.x, at.y, at.z],
        quaternion=[turn.x, turn.y, turn.z, turn.w],
        parent_frame=each.parent_frame_id,
        child_frame=each.child_frame_id,
    )


def _lines(scene: SceneUpdate) -> dict[str, Any]:
    """Return the lines of a scene's entities, and their discs as points with a radius."""
    found: dict[str, Any] = {}
    for entity in scene.entities:
        strips = [
            [(p.x + line.pose.position.x, p.y + line.pose.position.y, p.z) for p in line.points]
            for line in entity.lines
        ]
        if strips:
            found[f"/{entity.id}/lines"] = rr.LineStrips3D(strips)
        if entity.cylinders:
            centres = [(each.pose.position.x, each.pose.position.y, 0.0) for each in entity.cylinders]
            radii = [0.5 * each.size.x for each in entity.cylinders]
            found[f"/{entity.id}/discs"] = rr.Points3D(centres, radii=radii)
    return found
