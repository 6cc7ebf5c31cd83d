"""Makes the readings that measurement models take from the messages of the sensors, for all sensors of the list."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from dynpf_protocol.messages import Message
from dynpf_services.scenario.kinds import sensor_kind, sensor_kinds
from dynpf_services.scenario.user_component import UserComponent
from dynpf_services.sensors.kind import ModelKind, ReadingKind, SensorKind

from dynpf.measurement.model import MeasurementModel
from dynpf.types import Floats
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
"""How readings of each type are made."""

TOPICS: Mapping[type, str] = {kind.type: sensor.topic for sensor in sensor_kinds() for kind in sensor.readings}
"""The topic from which readings of each type are made."""

MODELS: Mapping[type, ModelKind] = {model.table: model for sensor in sensor_kinds() for model in sensor.models}
"""The measurement models by the types of their tables."""


def is_message(kind: object) -> bool:
    """Return whether a type of readings is a type of messages: that of a user's own sensor, used unchanged."""
    return isinstance(kind, type) and issubclass(kind, Message)


def reading_types(tables: Iterable[Any], user_class: Callable[[str], type | None]) -> list[type]:
    """Return the types of the readings that measurement models take, by their tables.

    ``user_class`` returns a user's class by its name, None for a class that must not be imported, whose readings are
    then unknown.
    """

    def taken(table: Any) -> Any:
        """Return the type of readings that the model of a table takes, None if unknown."""
        if isinstance(table, UserComponent):
            return getattr(user_class(table.name), "reading", None)
        return MODELS[type(table)].reading

    return [kind for kind in map(taken, tables) if isinstance(kind, type) and (kind in TOPICS or is_message(kind))]


def announcing(kind: object) -> SensorKind | None:
    """Return the sensor whose announcement is needed to make readings of a type, or None."""
    found = KINDS.get(kind) if isinstance(kind, type) else None
    return None if found is None or found.after is None else sensor_kind(found.after.name)


def reading_of(message: Any, kind: type, announced: Any = None) -> Any:
    """Return the message as a reading of the given type, which must be made from its topic.

    ``announced`` is the announcement before it, where it is needed: for a scan, the message of its scanner.
    """
    return message if type(message) is kind else KINDS[kind].of(message, announced)


def size_of(reading: Any) -> int:
    """Return the number of readings in a batch: that of its landmarks or lines; a scan counts as one."""
    kind = KINDS.get(type(reading))
    return 1 if kind is None else kind.size(reading)


def example_readings(
    tables: Iterable[Any], models: Mapping[type, MeasurementModel[Any]], maps: Maps, pose: Floats
) -> Iterator[Any]:
    """Yield a reading for each measurement model, as expected at ``pose`` (3,), so that it passes the gates.

    A model with a method ``example()`` gives the reading itself; a user's model without that method is left out.
    """
    for table, (kind, model) in zip(tables, models.items(), strict=True):
        if hasattr(model, "example"):
            yield model.example()
            continue
        if isinstance(table, UserComponent):
            continue  # which readings it accepts is unknown
        found = KINDS.get(kind)
        message = None if found is None else found.example(maps, pose, model)
        if found is not None and message is not None:
            yield found.of(message, None if found.after is None else found.after.example)
