"""Rooms from above: the map or the walls, landmarks, people and doors."""

from collections.abc import Iterable

import msgspec
import numpy as np
from dynpf_experiments.pictures.drawing import Drawing, Layer, Pictures, Shape
from dynpf_experiments.pictures.source import RunSource
from dynpf_formats.recording.attachments import landmarks_of
from dynpf_protocol.errors import DynpfError
from dynpf_protocol.landmarks import Landmark

from dynpf_systems.rooms.config import RoomConfig
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.maps import NO_MAPS, Maps, maps_of
from dynpf_systems.rooms.messages import Obstacles

__all__ = ["PICTURES"]

REPLACED = frozenset({"robot", "estimated robot", "room", "landmarks", "company"})
"""The entities of the room's own scenes that are drawn from other messages, more often or more sharply."""

MOST_SEGMENTS = 5000
MOST_LANDMARKS = 500


def _draw(source: RunSource) -> Drawing | None:
    scenario = source.scenario
    configs = () if scenario is None else scenario.nodes.values()
    rooms = [config for config in configs if isinstance(config, RoomConfig)]
    landmarks = _landmarks(source)
    if not rooms and not landmarks and not any(isinstance(config, LocalizationConfig) for config in configs):
        return None
    maps = _maps(source)
    walls = [_walls(maps, room) for room in rooms[:1]] or [_walls(maps, None)]
    return Drawing(
        grids=[maps.grid] if maps.grid is not None and maps.segments is None else [],
        cells=[maps.grid] if maps.grid is not None and maps.segments is not None else [],
        shapes=[*(wall for wall in walls if wall is not None), *_marks(landmarks)],
        layers=[_company(source)] if source.carrying(Obstacles) else [],
        replaced=REPLACED,
        radii={"": rooms[0].robot_radius} if rooms else {},
    )


def _maps(source: RunSource) -> Maps:
    try:
        return NO_MAPS if source.context is None else maps_of(source.context)
    except DynpfError:
        return NO_MAPS


def _landmarks(source: RunSource) -> tuple[Landmark, ...]:
    """Return the landmarks of the scenario, or else those that came with a log."""
    known = None if source.scenario is None else source.scenario.landmarks
    if known:
        return tuple(known)
    try:
        return landmarks_of(source.recording.attachments)
    except msgspec.DecodeError:
        return ()


def _walls(maps: Maps, room: RoomConfig | None) -> Shape | None:
    """Return the map's segments, or the rectangle of a room without a map."""
    if maps.segments is not None:
        return Shape("pairs", maps.segments.segments[:MOST_SEGMENTS].reshape(-1, 2).T, "wall")
    if maps.grid is not None or room is None:
        return None
    x, y = room.width / 2, room.height / 2
    return Shape("loop", np.array([(-x, x, x, -x), (-y, -y, y, y)]), "wall")


def _marks(landmarks: Iterable[Landmark]) -> list[Shape]:
    return [
        Shape("disc", np.array([[mark.x], [mark.y]]), "landmark", text=str(mark.id))
        for mark in [*landmarks][:MOST_LANDMARKS]
    ]


def _company(source: RunSource) -> Layer:
    """Return people and closed doors as they were about."""
    known = [
        (at, message)
        for topic in source.carrying(Obstacles)[:1]
        for at, message in source.messages(topic, source.budget.readings)
        if isinstance(message, Obstacles)
    ]
    shapes = []
    for _, obstacles in known:
        doors = np.array([(door.x1, door.y1, door.x2, door.y2) for door in obstacles.doors]).reshape(-1, 2).T
        people = [
            Shape("disc", np.array([[person.x], [person.y]]), "obstacle", radius=person.radius)
            for person in obstacles.people
        ]
        shapes.append([*people, *([Shape("pairs", doors, "obstacle")] if doors.size else [])])
    return Layer(np.array([at for at, _ in known]), shapes)


PICTURES = Pictures(_draw)
