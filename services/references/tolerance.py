"""Compares messages by value: what another platform must reproduce, whose arithmetic may differ in the last bits.

Counts, order of fields, lengths, texts and whole numbers are compared exactly; numbers with a fraction, and the pixels
of frames, within the tolerances of one reviewed file.
"""

import base64
import tomllib
from collections import Counter
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from services.errors import UsageError
from services.recording.digest import Key
from services.runners.replay import Mismatch

__all__ = ["Said", "Tolerances", "first_beyond", "read_tolerances"]

_IMAGE = ("camera/image", "data")


class Tolerances(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``topics[topic][field]``: largest absolute difference, SI units or grey levels; ``*``: other fields."""

    first_ticks: Annotated[int, Meta(ge=1)]
    topics: dict[str, dict[str, Annotated[float, Meta(ge=0.0)]]]


class Said(NamedTuple):
    """What is compared of one message."""

    tick: int
    stamp_ns: int
    payload: bytes


def read_tolerances(checkout: Path) -> Tolerances:
    """Return what recordings/tolerances.toml says; raises UsageError."""
    path = checkout / "recordings" / "tolerances.toml"
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Tolerances)
    except (OSError, tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise UsageError(f"{path}: {error}") from error


def first_beyond(
    recorded: Mapping[Key, Said],
    made: Mapping[Key, Said],
    tolerances: Tolerances,
    stateless: Container[str] = (),
) -> Mismatch | None:
    """Return the first place where two runs differ by more than ``tolerances``, or None.

    Counts per node and topic are compared over everything given; values of nodes that are ``stateless`` at every tick,
    of others in the first ticks only.
    """
    counts = [Counter((key.node, key.topic) for key in side) for side in (recorded, made)]
    for node, topic in sorted(counts[0] | counts[1]):
        old, new = (count[node, topic] for count in counts)
        if old != new:
            return Mismatch(node, topic, 0, 0, "count", old, new)
    for key, old_said in sorted(recorded.items(), key=lambda item: (item[1].tick, item[0])):
        if old_said.tick >= tolerances.first_ticks and key.node not in stateless:
            continue
        found = _beyond_message(key.topic, old_said, made.get(key), tolerances.topics.get(key.topic, {}))
        if found is not None:
            return Mismatch(key.node, key.topic, old_said.tick, key.sequence, *found)
    return None


_Found = tuple[str, Any, Any]


def _beyond_message(topic: str, old: Said, new: Said | None, limits: Mapping[str, float]) -> _Found | None:
    if new is None:
        return "message", "present", "absent"
    if (old.tick, old.stamp_ns) != (new.tick, new.stamp_ns):
        return ("tick", old.tick, new.tick) if old.tick != new.tick else ("stamp_ns", old.stamp_ns, new.stamp_ns)
    left, right = (msgspec.json.decode(said.payload) for said in (old, new))
    if topic == _IMAGE[0]:
        found = _beyond_image(left.pop("data"), right.pop("data"), limits.get("data", 0.0))
        if found is not None:
            return found
    return _beyond("", "", left, right, limits)


def _beyond(path: str, field: str, a: Any, b: Any, limits: Mapping[str, float]) -> _Found | None:
    """``path`` is the place, such as parts[2].x; ``field`` the same without indices, as the tolerances name it."""
    if isinstance(a, float) and isinstance(b, float):
        return None if abs(a - b) <= limits.get(field, limits.get("*", 0.0)) else (path, a, b)
    if isinstance(a, dict) and isinstance(b, dict):
        if list(a) != list(b):
            return f"{path}.keys".lstrip("."), list(a), list(b)
        dot = "." if path else ""
        inner = (_beyond(f"{path}{dot}{key}", f"{field}{dot}{key}", a[key], b[key], limits) for key in a)
        return next((found for found in inner if found is not None), None)
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return f"{path}.length", len(a), len(b)
        items = enumerate(zip(a, b, strict=True))
        inner = (_beyond(f"{path}[{place}]", field, left, right, limits) for place, (left, right) in items)
        return next((found for found in inner if found is not None), None)
    return None if type(a) is type(b) and a == b else (path, a, b)


def _beyond_image(a: str, b: str, limit: float) -> _Found | None:
    left, right = (_pixels(text) for text in (a, b))
    if left is None or right is None or left.shape != right.shape:
        shapes = [None if image is None else list(image.shape) for image in (left, right)]
        return "data.shape", shapes[0], shapes[1]
    distance = np.abs(left.astype(np.int16) - right)
    place = np.unravel_index(np.argmax(distance), distance.shape)
    if distance[place] <= limit:
        return None
    return f"data, pixel {[int(index) for index in place]}", int(left[place]), int(right[place])


def _pixels(text: str) -> np.ndarray[Any, np.dtype[np.uint8]] | None:
    data = np.frombuffer(base64.b64decode(text), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(image, np.uint8)
