"""A satellite receiver or a tracker: the robot's position in the map."""

from typing import Any

from dynpf_protocol.messages import PositionFix
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import ModelKind, Read, ReadingKind, SensorKind, SensorTable, Simulated, Truth

from dynpf.measurement.position import GaussianPosition, GaussianPositionParams, Position
from dynpf.rng import Draws
from dynpf.types import Floats, NonNegative

__all__ = ["POSITION", "PositionSensor"]


class PositionSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The robot's position in the map, with the same Gaussian noise on both coordinates."""

    std: NonNegative = 0.1  # m


def _made(sensor: PositionSensor, _context: Context) -> Read:
    def read(truth: Truth, draws: Draws) -> PositionFix:
        """Return the position with noise."""
        noise_x, noise_y = (sensor.std * draws.standard_normal(2)).tolist()
        return PositionFix(x=truth.robot.x + noise_x, y=truth.robot.y + noise_y)

    return read


def _example(_maps: Any, pose: Floats, _model: Any) -> PositionFix:
    x, y, _ = pose.tolist()
    return PositionFix(x=x, y=y)


POSITION = SensorKind(
    name="position",
    message=PositionFix,
    simulated=Simulated(PositionSensor, _made),
    readings=(ReadingKind(Position, lambda fix, _: Position(fix.x, fix.y), _example),),
    models=(ModelKind(GaussianPositionParams, Position, GaussianPosition),),
)
