"""From the messages of the sensors to the readings that the measurement models take, whichever sensors there are."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from dynpf_protocol.messages import Message
from dynpf_services.scenario.kinds import sensor_kind, sensor_kinds
from dynpf_services.scenario.user_component import UserComponent
from dynpf_services.sensors.kind import ModelKind, ReadingKind, SensorKind

from dynpf.measurement.model import MeasurementModel
from dynpf.se2 import Floats
from dynpf_systems.rooms.maps import Maps

__all__ = [
    "KINDS",
    "MODELS",
    "TOPICS",
    "announcing",
    "example_readings",
    "is_message",
    "reading_of",
    "reading_types",
    "size_of",
]

KINDS: Mapping[type, ReadingKind] = {kind.type: kind for sensor in sensor_kinds() for kind in sensor.readings}
"""The types of readings, and how each is made."""

TOPICS: Mapping[type, str] = {kind.type: sensor.topic for sensor in sensor_kinds() for kind in sensor.readings}
"""The types of readings, and the topic that each is made from."""

MODELS: Mapping[type, ModelKind] = {model.table: model for sensor in sensor_kinds() for model in sensor.models}
"""The measurement models by the types of their tables."""


def is_message(kind: object) -> bool:
    """Return whether a type of readings is one of messages: of a user's own sensor, taken as it comes."""
    return isinstance(kind, type) and issubclass(kind, Message)


def reading_types(tables: Iterable[Any], user_class: Callable[[str], type | None]) -> list[type]:
    """Return the types of the readings that measurement models take, by their tables.

    ``user_class`` gives a class of the user's by its name, None for one that must not be imported: what that takes
    nobody knows.
    """

    def taken(table: Any) -> Any:
        if isinstance(table, UserComponent):
            return getattr(user_class(table.name), "reading", None)
        return MODELS[type(table)].reading

    return [kind for kind in map(taken, tables) if isinstance(kind, type) and (kind in TOPICS or is_message(kind))]


def announcing(kind: object) -> SensorKind | None:
    """Return the sensor that has to have said something before readings of a type can be made, None without such."""
    found = KINDS.get(kind) if isinstance(kind, type) else None
    return None if found is None or found.after is None else sensor_kind(found.after.name)


def reading_of(message: Any, kind: type, announced: Any = None) -> Any:
    """Return the message as a reading of the given type, one of those made from its topic.

    ``announced`` is what was said before it, where that is needed: of a scan, the message of its scanner.
    """
    return message if type(message) is kind else KINDS[kind].of(message, announced)


def size_of(reading: Any) -> int:
    """Return how many readings there are in one: of landmarks or lines, so many; a scan is taken as a whole."""
    kind = KINDS.get(type(reading))
    return 1 if kind is None else kind.size(reading)


def example_readings(
    tables: Iterable[Any], models: Mapping[type, MeasurementModel[Any]], maps: Maps, pose: Floats
) -> Iterator[Any]:
    """Yield a reading for each measurement model, as it would be at ``pose`` (3,), so that it is believed.

    A model with a method ``example()`` gives one itself; one that takes messages as they come is left out without.
    """
    for table, (kind, model) in zip(tables, models.items(), strict=True):
        if hasattr(model, "example"):
            yield model.example()
            continue
        if isinstance(table, UserComponent):
            continue  # what it makes of our readings nobody knows
        found = KINDS.get(kind)
        message = None if found is None else found.example(maps, pose, model)
        if found is not None and message is not None:
            yield found.of(message, None if found.after is None else found.after.example)
