"""Robots in rooms: the simulated room, localization in a map, and waypoints."""

from collections.abc import Iterator, Set

import msgspec
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Message
from dynpf_services.estimates import GAPS
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import FactKind, NodeKind, Take

from dynpf_systems.rooms.config import RoomConfig, WaypointsConfig
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.readings import TOPICS, announcing, reading_types
from dynpf_systems.rooms.maps import MapConfig, maps_of, named_file, open_maps
from dynpf_systems.rooms.sensors.initial_pose import INITIAL_POSE
from dynpf_systems.rooms.sensors.odometry import ODOMETRY, ODOMETRY_POSE

__all__ = ["LANDMARKS", "LOCALIZATION", "MAP", "ROOM", "WAYPOINTS"]


def _take_map(path: str, config: MapConfig, take: Take) -> None:
    open_maps(config, None, lambda name: take(path, name))


def _bare_map(config: MapConfig) -> MapConfig:
    file = named_file(config)
    return config if file is None else msgspec.structs.replace(config, file=file.rpartition("/")[2])


def _map_files(config: MapConfig) -> tuple[str, ...]:
    file = named_file(config)
    return () if file is None else (file,)


MAP = FactKind(
    MapConfig,
    about="The map: a grid or walls, m",
    files=_map_files,
    take=_take_map,
    bare=_bare_map,
    opened=maps_of,
    key=".file",
)

LANDMARKS = FactKind(tuple[Landmark, ...], about="Landmarks of the map, m; where it is left out, those of the log")


def _room_writes(config: RoomConfig, _context: Context) -> set[str]:
    company = {"truth/obstacles"} if config.people is not None or config.doors else set()
    return {"truth/robot", "truth/scene", *company}


def _two_drivers(config: RoomConfig, context: Context) -> Iterator[str]:
    if config.driver is not None and context.beside("controller") is not None:
        yield "simulator.driver: the [controller] drives already"


def _room_reads(config: RoomConfig, _context: Context) -> set[str]:
    commands = {"controller/command"} if config.driver is None else set()
    return {*commands, "operator/drive", "operator/place", *({"operator/door"} if config.doors else ())}


ROOM = NodeKind(
    config=RoomConfig,
    build="dynpf_systems.rooms.world:build",
    reads=_room_reads,
    writes=_room_writes,
    problems=_two_drivers,
)


def _readings(config: LocalizationConfig, context: Context) -> Set[str | type[Message]]:
    types = reading_types(config.measurement, context.user_class)
    read = {INITIAL_POSE.topic, ODOMETRY.topic, ODOMETRY_POSE.topic, GAPS}
    read |= {sensor.topic for kind in types if (sensor := announcing(kind)) is not None}
    return read.union(TOPICS.get(kind, kind) for kind in types)


def _needs(config: LocalizationConfig, context: Context) -> dict[str | type[Message], str]:
    types = reading_types(config.measurement, context.user_class)
    return {TOPICS.get(kind, kind): "measurement" for kind in types}


LOCALIZATION = NodeKind(
    config=LocalizationConfig,
    build="dynpf_systems.rooms.localization.estimator:build",
    reads=_readings,
    needs=_needs,
    writes=lambda *_: (
        *(f"estimator/{name}" for name in ("state", "pose", "dead_reckoning", "particles", "transforms", "scene")),
        "log",
    ),
)

WAYPOINTS = NodeKind(
    config=WaypointsConfig,
    build="dynpf_systems.rooms.waypoints:build",
    reads=lambda *_: {"estimator/state"},
    writes=lambda *_: {"controller/command"},
)
