"""From a scenario to its nodes: the one place that knows which class answers to which section."""

from services.controller.config import RearrangementControllerConfig
from services.controller.rearrangement import RearrangementController
from services.controller.waypoints import WaypointController
from services.errors import ScenarioError
from services.estimator.config import LocalizationConfig
from services.estimator.localization import LocalizationEstimator
from services.estimator.rearrangement import RearrangementEstimator
from services.node import Node
from services.scenario import Scenario
from services.sensors.config import LogSensorsConfig
from services.sensors.log import LogSensors
from services.sensors.simulated import SimulatedSensors
from services.simulator.config import WorkspaceConfig
from services.simulator.room import RoomSimulator
from services.simulator.workspace import WorkspaceSimulator
from services.vision.node import VisionNode

__all__ = ["build_nodes"]


def build_nodes(scenario: Scenario) -> dict[str, Node]:
    raise NotImplementedError
