"""The list of sensors: whatever stands in it can be told apart, and has all that goes with what it says of itself."""

from itertools import chain

import pytest
from dynpf_protocol.topics import TOPICS
from dynpf_services.scenario.kinds import sensor_kinds
from dynpf_services.sensors.kind import SensorKind

SENSORS = sensor_kinds()


def test_no_two_sensors_share_a_name_a_type_of_readings_or_a_table() -> None:
    readings = [reading.type for sensor in SENSORS for reading in sensor.readings]
    models = [model.table for sensor in SENSORS for model in sensor.models]
    tables = [sensor.simulated.table for sensor in SENSORS if sensor.simulated is not None]
    for found in ([sensor.name for sensor in SENSORS], readings, models, tables):
        assert len(found) == len({*found}) > 1


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda sensor: sensor.name)
def test_what_a_sensor_refers_to_is_there(sensor: SensorKind) -> None:
    names = {other.name for other in SENSORS}
    announced = () if sensor.announced is None else (sensor.announced.name,)
    assert {*announced, *(reading.after.name for reading in sensor.readings if reading.after is not None)} <= names
    assert sensor.row.type is sensor.message
    assert {model.reading for model in sensor.models} <= {sensor.message, *(kind.type for kind in sensor.readings)}
    if sensor.checked is not None:
        assert TOPICS[f"log/{sensor.name}"].type is sensor.message


def test_every_model_of_a_sensor_can_be_named_in_a_scenario() -> None:
    kinds = [model.table.__struct_config__.tag for model in chain.from_iterable(sensor.models for sensor in SENSORS)]
    assert {"range_bearing", "likelihood_field", "polar_lines", "position"} <= {*kinds}
    assert len(kinds) == len({*kinds})
