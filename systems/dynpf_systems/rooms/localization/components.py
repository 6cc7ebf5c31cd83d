"""Builds the library's objects from the tables of a scenario; no other module knows which class a table stands for."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.user_component import UserComponent

from dynpf.fields.flow import DescentFlow
from dynpf.filters.adaptation import (
    Augmented,
    AugmentedParams,
    Kld,
    KldParams,
    Recovery,
    Rescue,
    Rescuer,
    SensorResetting,
    SensorResettingParams,
    Sizing,
)
from dynpf.filters.extended import ExtendedKalman, ExtendedKalmanParams
from dynpf.filters.jump import Jump, JumpParams
from dynpf.filters.models import Models
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.proposal import Auxiliary, LocalLinearization, Optimal, Proposal
from dynpf.filters.refinement import ScanMatching
from dynpf.filters.regularization import Regularization
from dynpf.filters.relocation import Relocation, RelocationParams
from dynpf.filters.resampling import Resampling
from dynpf.filters.search import Search, SearchStart
from dynpf.filters.start import UniformStart, pose_source
from dynpf.filters.unscented import UnscentedKalman, UnscentedKalmanParams
from dynpf.measurement.model import GaussianMeasurement, MeasurementModel
from dynpf.measurement.range_bearing import SensorRows
from dynpf.motion.arcs import Arcs, ArcsParams
from dynpf.motion.calibration import BEARING_BIAS, RANGE_SCALE, CalibratedArcs
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.motion.gradient_flow import GradientFlow
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.motion.model import Displacement, GaussianMotion, MotionModel, Twist
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.motion.velocity import Velocity, VelocityParams
from dynpf.portable import hypot
from dynpf.se2 import arc_chord, arc_displacement
from dynpf_systems.rooms.localization.config import GradientFlowTable, LocalizationConfig, SirParams
from dynpf_systems.rooms.localization.localizers import CloudFilter, GaussianLocalizer, Localizer, ParticleLocalizer
from dynpf_systems.rooms.localization.readings import MODELS, TOPICS, is_message
from dynpf_systems.rooms.localization.user_components import Classes, made, required_methods
from dynpf_systems.rooms.maps import Maps

__all__ = ["Motion", "Moved", "localizer_of", "measurements_of", "motion_of"]

Measurements = dict[type, MeasurementModel[Any]]

ESTIMATOR = "estimator"
"""The scenario's key of an estimator with the usual name."""


class Moved(NamedTuple):
    """A displacement measured by odometry, and its duration in seconds."""

    displacement: Displacement
    duration: float


class Motion(NamedTuple):
    """A motion model, and the function that makes its control from a held twist or a displacement."""

    model: MotionModel[Any]
    control: Callable[[Twist | Moved], Any]


def motion_of(config: LocalizationConfig, maps: Maps, classes: Classes, key: str = ESTIMATOR) -> Motion:
    """Return the motion model; raises ScenarioError, at the node's ``key``, where a table does not fit the others."""
    table = config.motion
    if config.calibration is not None and not isinstance(table, ArcsParams):
        raise ScenarioError(f"{key}.calibration goes with the motion of kind 'arcs' alone")
    match table:
        case ArcsParams():
            arcs = Arcs(table) if config.calibration is None else CalibratedArcs(table, config.calibration)
            return Motion(arcs, _twist)
        case VelocityParams():
            return Motion(Velocity(table), _twist)
        case OdometryParams():
            return Motion(OdometryMotion(table), _displacement)
        case CapsuleStepParams():
            return Motion(CapsuleStep(table), _turn_and_way)
        case LinearGaussianParams():
            return _linear(table, key)
        case GradientFlowTable():
            return Motion(GradientFlow(table, DescentFlow(table.field)), lambda moved: moved.duration)
        case UserComponent():
            model = made(table, f"{key}.motion", (MotionModel,), classes, maps._asdict())
            control = getattr(type(model), "control", Twist)
            if control not in _CONTROLS:
                raise ScenarioError(
                    f"{key}.motion.kind: {table.name!r} has the class attribute control = {control!r};"
                    f" expected one of {_names(_CONTROLS)}"
                )
            return Motion(model, _CONTROLS[control])


def measurements_of(config: LocalizationConfig, maps: Maps, classes: Classes, key: str = ESTIMATOR) -> Measurements:
    """Return the measurement models by the type of reading that each takes; raises ScenarioError."""
    models: Measurements = {}
    rows = None if config.calibration is None else SensorRows(BEARING_BIAS, RANGE_SCALE)
    for index, table in enumerate(config.measurement):
        where = f"{key}.measurement.{index}"
        reading, model = _measurement(table, where, maps, classes, rows)
        if TOPICS.get(reading, reading) in {TOPICS.get(other, other) for other in models}:
            what = TOPICS.get(reading, reading.__name__)
            raise ScenarioError(f"{where}: another measurement model already uses the messages of {what}")
        models[reading] = model
    return models


def localizer_of(
    config: LocalizationConfig,
    motion: MotionModel[Any],
    measurements: Measurements,
    maps: Maps,
    classes: Classes,
    *,
    key: str = ESTIMATOR,
) -> Localizer:
    """Return the filter; raises ScenarioError where it needs methods that the models lack."""
    table = config.filter
    proposal: Proposal = _own_or_given(config.proposal, f"{key}.proposal", Proposal, classes)
    resampling: Resampling = _own_or_given(config.resampling, f"{key}.resampling", Resampling, classes)
    match table:
        case SirParams():
            _ask(
                config,
                key,
                motion,
                measurements,
                f"the proposal {_kind(config.proposal)}",
                *_ASKED.get(type(proposal), ()),
            )
            regularization: Regularization | None = _own_or_given(
                config.regularization, f"{key}.regularization", Regularization, classes
            )
            sizing, recovery = _adaptation(config, classes, key)
            models = Models(motion, measurements)
            rescue = None if recovery is None else _rescue(config, recovery, models, maps, key)
            return ParticleLocalizer(
                ParticleFilter(
                    motion,
                    measurements,
                    proposal=proposal,
                    resampling=resampling,
                    sizing=sizing,
                    rescue=rescue,
                    regularization=regularization,
                    refinement=_refinement(config, models, key),
                    threads=table.threads,
                )
            )
        case ExtendedKalmanParams() | UnscentedKalmanParams():
            _ask(config, key, motion, measurements, f"the filter {_kind(table)}", GaussianMotion, GaussianMeasurement)
            for name in _OF_PARTICLES:
                if getattr(config, name) != _DEFAULTS[name]:
                    raise ScenarioError(f"{key}.{name} has no place in the filter {_kind(table)}")
            gaussian_models: Any = measurements
            gaussian_motion: Any = motion
            if isinstance(table, ExtendedKalmanParams):
                return GaussianLocalizer(ExtendedKalman(gaussian_motion, gaussian_models, table))
            return GaussianLocalizer(UnscentedKalman(gaussian_motion, gaussian_models, table))
        case UserComponent():
            parts = {"motion": motion, "measurements": measurements, "proposal": proposal, "resampling": resampling}
            own: CloudFilter = made(table, f"{key}.filter", (CloudFilter,), classes, parts)
            return ParticleLocalizer(own)


_ASKED: Mapping[type, tuple[type, ...]] = {
    Auxiliary: (GaussianMotion,),
    Optimal: (GaussianMotion, GaussianMeasurement),
    LocalLinearization: (GaussianMotion, GaussianMeasurement),
}
"""The roles that each proposal needs of the models."""

_OF_PARTICLES = ("proposal", "resampling", "regularization", "refinement", "adaptation")
_DEFAULTS = {field.name: field.default for field in msgspec.structs.fields(LocalizationConfig)}


def _ask(config: LocalizationConfig, key: str, motion: Any, measurements: Measurements, who: str, *roles: type) -> None:
    """Raise ScenarioError where a model lacks a method of a role it needs."""
    asked: list[tuple[str, Any, Any, type]] = [(f"{key}.motion", config.motion, motion, GaussianMotion)]
    for index, (table, model) in enumerate(zip(config.measurement, measurements.values(), strict=True)):
        asked.append((f"{key}.measurement.{index}", table, model, GaussianMeasurement))
    for where, table, model, role in asked:
        missing = [name for name in required_methods(role) if not hasattr(model, name)]
        if role in roles and missing:
            raise ScenarioError(
                f"{where}: {who} needs a {role.__name__}; {_kind(table)} has no {', no '.join(missing)}"
            )


def _kind(table: Any) -> str:
    return repr(table.name if isinstance(table, UserComponent) else table.__struct_config__.tag)


def _measurement(
    table: Any, key: str, maps: Maps, classes: Classes, rows: SensorRows | None
) -> tuple[type, MeasurementModel[Any]]:
    if isinstance(table, UserComponent):
        return _own_measurement(table, key, maps, classes)
    kind = MODELS[type(table)]
    arguments = [table]
    if kind.needs:
        arguments.append(getattr(maps, kind.needs))
        if arguments[-1] is None:
            raise ScenarioError(f"{key} needs {_NEEDED[kind.needs]}; this run has none")
    if kind.calibrated:
        arguments.append(rows)
    return kind.reading, kind.make(*arguments)


def _own_measurement(
    table: UserComponent, key: str, maps: Maps, classes: Classes
) -> tuple[type, MeasurementModel[Any]]:
    own = made(table, key, (MeasurementModel,), classes, maps._asdict())
    reading = getattr(type(own), "reading", object)
    if reading not in TOPICS and not is_message(reading):
        raise ScenarioError(
            f"{key}.kind: {table.name!r} must name the type of its readings in the class attribute 'reading': one of"
            f" {_names(TOPICS)}, or a type of messages of your own"
        )
    return reading, own


def _adaptation(
    config: LocalizationConfig, classes: Classes, key: str
) -> tuple[Sizing | None, Recovery | JumpParams | RelocationParams | None]:
    sizing: list[Sizing] = []
    recovery: list[Recovery | JumpParams | RelocationParams] = []
    for index, table in enumerate(config.adaptation):
        match table:
            case KldParams():
                sizing.append(Kld(table))
            case AugmentedParams():
                recovery.append(Augmented(table))
            case SensorResettingParams():
                recovery.append(SensorResetting(table))
            case JumpParams() | RelocationParams():
                recovery.append(table)
            case UserComponent():
                own = made(table, f"{key}.adaptation.{index}", (Sizing, Recovery), classes, {})
                (sizing if hasattr(own, "size") else recovery).append(own)
    if len(sizing) > 1 or len(recovery) > 1:
        raise ScenarioError(f"{key}.adaptation: expected at most one rule for the number of particles and one recovery")
    return next(iter(sizing), None), next(iter(recovery), None)


def _rescue(
    config: LocalizationConfig, recovery: Recovery | JumpParams | RelocationParams, models: Models, maps: Maps, key: str
) -> Rescuer:
    restart = config.restart or (
        SearchStart() if isinstance(recovery, JumpParams | RelocationParams) else UniformStart()
    )
    try:
        source = pose_source(restart, grid=maps.grid, models=models)
    except ValueError as error:
        raise ScenarioError(f"{key}.restart: {error}") from error
    if not isinstance(recovery, JumpParams | RelocationParams):
        return Rescue(recovery, source)
    if not isinstance(source, Search):
        raise ScenarioError(f"{key}.restart: expected the kind 'search', which the adaptation {_kind(recovery)} needs")
    return Jump(recovery, source) if isinstance(recovery, JumpParams) else Relocation(recovery, source)


def _refinement(config: LocalizationConfig, models: Models, key: str) -> ScanMatching | None:
    if config.refinement is None:
        return None
    try:
        return ScanMatching(config.refinement, models)
    except ValueError as error:
        raise ScenarioError(f"{key}.refinement: {error}") from error


def _own_or_given(table: Any, key: str, role: type, classes: Classes) -> Any:
    """Return the user's component, or the table itself: a component without state and map is its parameters."""
    return made(table, key, (role,), classes, {}) if isinstance(table, UserComponent) else table


_NEEDED = {"landmarks": "[[landmarks]]", "grid": "a [map]", "segments": "a [map] of segments"}


def _twist(moved: Twist | Moved) -> Twist:
    """Return the twist; for a displacement, that of the arc with the same chord and turn."""
    if isinstance(moved, Twist):
        return moved
    (dx, dy, turn), duration = moved
    chord = math.copysign(hypot(dx, dy), dx)
    return Twist(chord / float(arc_chord(1.0, turn)) / duration, turn / duration, duration)


def _displacement(moved: Twist | Moved) -> Displacement:
    if isinstance(moved, Moved):
        return moved.displacement
    dx, dy, turn = arc_displacement(moved.v * moved.duration, moved.w * moved.duration).tolist()
    return Displacement(dx, dy, turn)


def _turn_and_way(moved: Twist | Moved) -> CapsuleMotion:
    twist = _twist(moved)
    return CapsuleMotion(rho=twist.v * twist.duration, turn=twist.w * twist.duration)


_CONTROLS: Mapping[type, Callable[[Twist | Moved], Any]] = {Twist: _twist, Displacement: _displacement}


def _linear(table: LinearGaussianParams, key: str) -> Motion:
    """Return the linear model; its control is the step's distance and turn, or empty without an input matrix."""
    model = LinearGaussian(table)
    columns = len(table.input[0]) if table.input else 0
    if len(table.transition) != 3 or columns not in {0, 2}:
        raise ScenarioError(
            f"{key}.motion: expected a linear_gaussian motion of x, y and theta, and two columns in its input if it"
            " has one: the step's distance in m and its turn in rad"
        )

    def control(moved: Twist | Moved) -> Any:
        """Return distance and turn of the step by odometry."""
        twist = _twist(moved)
        return np.array([twist.v, twist.w][:columns]) * twist.duration

    return Motion(model, control)


def _names(types: Mapping[type, Any]) -> str:
    return ", ".join(kind.__name__ for kind in types)
