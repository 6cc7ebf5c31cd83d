"""Readings of the same stamp that wait for an update, and what sensors have announced, such as a scanner's limits."""

from collections.abc import Iterable
from typing import Any

import msgspec
from dynpf_protocol.messages import LandmarkReadings, Message, Scanner
from dynpf_runtime.node import Output, Received, State
from dynpf_services.estimates import warning
from dynpf_services.scenario.schema import key_of
from msgspec import UNSET

from dynpf.maps.landmarks import LandmarkMap
from dynpf.measurement.range_bearing import RangeBearingReadings
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.origin import LocalOrigin
from dynpf_systems.rooms.localization.readings import TOPICS, announcing, is_message, reading_of
from dynpf_systems.rooms.sensors.scan import SCANNER

__all__ = ["Intake"]


class Intake:
    """Makes readings, of the types that the measurement models take, from messages; ``pending`` ones await an update.

    A message that gives no reading is left out, with a warning the first time.
    """

    def __init__(
        self,
        config: LocalizationConfig,
        kinds: Iterable[type],
        landmarks: LandmarkMap | None,
        name: str,
        origin: LocalOrigin | None = None,
    ) -> None:
        self._origin = origin
        kinds = tuple(kinds)
        self._name = name
        self._kinds = {TOPICS[kind]: kind for kind in kinds if kind in TOPICS}
        self._own = frozenset(kind for kind in kinds if is_message(kind))
        self._landmarks = landmarks if RangeBearingReadings in kinds else None
        self._limits = (config.scan_range_min, config.scan_range_max)
        self._announcing = {sensor.topic: sensor.message for kind in kinds if (sensor := announcing(kind)) is not None}
        self._announced: dict[str, Message] = {}
        if config.scan_range_max is not None and SCANNER.topic in self._announcing:
            self._announced[SCANNER.topic] = self._limited(Scanner(range_max=config.scan_range_max))
        self._unknown: list[int] = []
        self._unannounced: list[str] = []
        self.pending: list[Any] = []  # empty between steps

    def take(self, received: Received) -> list[Output]:
        """Take a message; keep it if a measurement model uses it; return warnings."""
        message, topic = received.message, received.topic
        if topic in self._announcing:
            self._announced[topic] = self._limited(message) if isinstance(message, Scanner) else message
            return []
        kind = type(message) if type(message) in self._own else self._kinds.get(topic)
        if kind is None:
            return []
        sensor = announcing(kind)
        if sensor is not None and sensor.topic not in self._announced:
            return self._warn_of_order(received, sensor.topic)
        reading = reading_of(message, kind, None if sensor is None else self._announced[sensor.topic])
        self.pending.append(reading if self._origin is None else self._origin.reading(reading))
        return self._warn_of_landmarks(received, message)

    def freeze(self) -> State:
        """Return what sensors have announced, and the warnings already given."""
        return {
            "announced": {topic: msgspec.to_builtins(message) for topic, message in self._announced.items()},
            "unknown": list(self._unknown),
            "unannounced": list(self._unannounced),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._announced = {
            topic: msgspec.convert(value, self._announcing[topic]) for topic, value in state["announced"].items()
        }
        self._unknown = list(state["unknown"])
        self._unannounced = list(state["unannounced"])

    def _limited(self, scanner: Scanner) -> Scanner:
        """Return the scanner's limits, overridden by those of the scenario."""
        least, greatest = self._limits
        return Scanner(
            range_min=scanner.range_min if least is None else least,
            range_max=scanner.range_max if greatest is None else greatest,
        )

    def _warn_of_order(self, received: Received, missing: str) -> list[Output]:
        """Return a warning, the first time, that a sensor has not announced itself."""
        if received.topic in self._unannounced:
            return []
        self._unannounced.append(received.topic)
        text = f"{received.topic}: left out as long as no message on {missing} has come before it"
        if missing == SCANNER.topic:
            text += (
                f", which says what a beam without return reads; set {key_of(self._name)}.scan_range_max, import the"
                " log again, or let whoever writes the scans write that, too"
            )
        return [self._warning(received, text)]

    def _warn_of_landmarks(self, received: Received, message: Message) -> list[Output]:
        """Return a warning for each landmark that is not in the map, the first time it is seen."""
        if self._landmarks is None or not isinstance(message, LandmarkReadings):
            return []
        seen = dict.fromkeys(reading.landmark for reading in message.readings if reading.x is UNSET)
        new = [number for number in seen if number not in self._landmarks and number not in self._unknown]
        self._unknown += new
        texts = (f"{received.topic}: landmark {number} is not in the map; its readings are left out" for number in new)
        return [self._warning(received, text) for text in texts]

    def _warning(self, received: Received, text: str) -> Output:
        return warning(text, received.stamp_ns, self._name)
