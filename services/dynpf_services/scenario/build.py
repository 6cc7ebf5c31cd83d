"""From a scenario to its nodes: the one place that knows which class answers to which section."""

import math

import msgspec
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.node import Node
from dynpf_runtime.plan import Plan

from dynpf_services.colon import ColonWorld
from dynpf_services.controller.config import RearrangementControllerConfig, WaypointsConfig
from dynpf_services.controller.rearrangement import RearrangementController
from dynpf_services.controller.waypoints import WaypointController
from dynpf_services.estimator.capsule import CapsuleEstimator
from dynpf_services.estimator.config import CapsuleEstimatorConfig, LocalizationConfig, RearrangementConfig
from dynpf_services.estimator.localization import LocalizationEstimator
from dynpf_services.estimator.readings import TOPICS
from dynpf_services.estimator.rearrangement import RearrangementEstimator
from dynpf_services.maps import Maps, open_maps
from dynpf_services.scenario.schema import Scenario, colon_world, resolved_json
from dynpf_services.scenario.user_code import check_allowed, find_class
from dynpf_services.sensors.capsule import CapsuleSensors
from dynpf_services.sensors.config import CapsuleSensorsConfig, LogSensorsConfig, SimulatedSensorsConfig
from dynpf_services.sensors.log import LogSensors
from dynpf_services.sensors.simulated import SimulatedSensors
from dynpf_services.simulator.capsule import CapsuleSimulator
from dynpf_services.simulator.config import CapsuleConfig, RoomConfig, WorkspaceConfig
from dynpf_services.simulator.room import RoomSimulator
from dynpf_services.simulator.workspace import WorkspaceSimulator
from dynpf_services.task import NOISE, RearrangementTask
from dynpf_services.vision.config import VisionConfig
from dynpf_services.vision.node import VisionNode

__all__ = ["build_node", "build_nodes", "plan_of", "user_classes"]

READING_TOPICS = frozenset(TOPICS.values())


def plan_of(scenario: Scenario) -> Plan:
    """Return the plan of a run, as the runtime takes it."""
    return Plan(
        names=scenario.nodes,
        build=lambda: build_nodes(scenario),
        seed=scenario.seed,
        clock=scenario.clock,
        rate=scenario.rate,
        tick_ns=scenario.tick_ns,
        max_ticks=scenario.max_ticks,
        plays_log=scenario.needs_log,
        state_digest_ticks=scenario.state_digest_ticks,
        faults=scenario.faults,
        text=resolved_json(scenario),
    )


def build_nodes(scenario: Scenario) -> dict[str, Node]:
    """Return the nodes of a run by name, in tick order, each in its first state.

    Raises ScenarioError where a section does not fit the rest, or a fault lies on a way that nothing takes.
    """
    maps, world = _maps(scenario), colon_world(scenario)
    nodes = {name: _built(scenario, name, maps, world) for name in scenario.nodes}
    if isinstance(scenario.estimator, LocalizationConfig) and "sensors" in nodes:
        unheard = {one for one in nodes["estimator"].reads - nodes["sensors"].writes if one in READING_TOPICS}
        for topic in sorted(unheard):
            raise ScenarioError(f"estimator.measurement: reads {topic}, which the sensors of this run do not write")
    for place, fault in enumerate(scenario.faults):
        if fault.topic not in nodes[fault.to].reads:
            known = ", ".join(sorted(nodes[fault.to].reads))
            raise ScenarioError(f"faults.{place}.topic: {fault.to} does not read {fault.topic}; it reads {known}")
    return nodes


def build_node(scenario: Scenario, name: str) -> Node:
    """Return one node of a run in its first state; raises ScenarioError where its section does not fit the rest."""
    return _built(scenario, name, _maps(scenario), colon_world(scenario))


def user_classes(scenario: Scenario) -> dict[str, type]:
    """Return the user's classes that a scenario names, by name.

    Raises ScenarioError for one that is not there, and imports none whose module ``user_code`` lacks: those are of a
    scenario out of a recording, and its reader has not allowed them.
    """
    check_allowed(scenario.user_classes, scenario.user_code, "scenario")
    return {one.text: find_class(one) for one in scenario.user_classes}


def _maps(scenario: Scenario) -> Maps:
    marks = scenario.landmarks if scenario.landmarks or scenario.needs_log else None
    try:
        return open_maps(scenario.map, marks, lambda path: _content(scenario, path))
    except ValueError as error:
        raise ScenarioError(f"map: {error}") from error


def _content(scenario: Scenario, path: str) -> bytes:
    """Return what is in a file that the scenario names, which has been read with it."""
    file = scenario.files.get(path.rpartition("/")[2])
    if file is None or not file.data:
        raise ScenarioError(f"map.file: the content of {path} did not come along with the scenario")
    return file.data


def _built(scenario: Scenario, name: str, maps: Maps, world: ColonWorld | None) -> Node:
    try:
        return _build(scenario, name, maps, world)
    except ValueError as error:
        raise ScenarioError(f"{name}: {error}") from error


def _build(scenario: Scenario, name: str, maps: Maps, world: ColonWorld | None) -> Node:
    seed, tick_s, landmarks = scenario.seed, scenario.tick_s, scenario.landmarks
    match getattr(scenario, name):
        case WorkspaceConfig() as config:
            return WorkspaceSimulator(config=config, seed=seed, tick_s=tick_s, task=_task(scenario, name))
        case RoomConfig() as config:
            return RoomSimulator(config=config, seed=seed, tick_s=tick_s, landmarks=landmarks, maps=maps)
        case SimulatedSensorsConfig() as config:
            return SimulatedSensors(
                config=config, seed=seed, tick_s=tick_s, task=scenario.task, landmarks=landmarks, maps=maps
            )
        case (CapsuleConfig() | CapsuleSensorsConfig() | CapsuleEstimatorConfig()) as capsule:
            return _build_capsule(capsule, seed, world, name)
        case LogSensorsConfig() as config:
            return LogSensors(config=config, seed=seed, tick_s=tick_s, landmarks=landmarks)
        case RearrangementConfig() as config:
            return RearrangementEstimator(config=config, seed=seed, tick_s=tick_s, task=_task(scenario, name))
        case LocalizationConfig() as config:
            return LocalizationEstimator(
                config=config,
                seed=seed,
                landmarks=landmarks,
                maps=maps,
                classes=user_classes(scenario),
                scan_range_max=_scan_range_max(scenario),
            )
        case RearrangementControllerConfig() as config:
            return RearrangementController(config=config, seed=seed, tick_s=tick_s, task=_task(scenario, name))
        case WaypointsConfig() as config:
            return WaypointController(config=config, seed=seed, tick_s=tick_s)
        case VisionConfig() as config:
            return VisionNode(config=_with_noise(config, scenario.task), seed=seed)
        case missing:
            raise ScenarioError(f"{name}: takes no part in this run ({missing!r})")


def _scan_range_max(scenario: Scenario) -> float | None:
    sensors = scenario.sensors
    return sensors.scan.range_max if isinstance(sensors, SimulatedSensorsConfig) and sensors.scan is not None else None


def _with_noise(config: VisionConfig, task: RearrangementTask | None) -> VisionConfig:
    """Return the configuration with the task's noise, where it does not say otherwise."""
    if config.position_noise_m is not None or task is None:
        return config
    return msgspec.structs.replace(config, position_noise_m=math.sqrt(NOISE[task.noise].measurement))


def _task(scenario: Scenario, name: str) -> RearrangementTask:
    if scenario.task is None:
        raise ScenarioError(f"{name}: needs the table [task] with the parts and their goals")
    return scenario.task


def _build_capsule(
    config: CapsuleConfig | CapsuleSensorsConfig | CapsuleEstimatorConfig,
    seed: int,
    world: ColonWorld | None,
    name: str,
) -> Node:
    if world is None:
        raise ScenarioError(f"{name}: needs the table [colon] with the tube and when its maps hold")
    match config:
        case CapsuleConfig():
            return CapsuleSimulator(config=config, seed=seed, world=world)
        case CapsuleSensorsConfig():
            return CapsuleSensors(config=config, seed=seed, world=world)
        case CapsuleEstimatorConfig():
            return CapsuleEstimator(config=config, seed=seed, world=world)
