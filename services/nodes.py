"""From a scenario to its nodes: the one place that knows which class answers to which section."""

from services.node import Node
from services.scenario import Scenario

__all__ = ["build_nodes"]


def build_nodes(scenario: Scenario) -> dict[str, Node]:
    raise NotImplementedError
