"""Estimators say in words which of their inputs never came, and go on."""

import pytest
from dynpf_protocol.messages import HostEvent, Log
from dynpf_runtime.node import Node, Received, Step
from dynpf_services.estimates import GAPS
from dynpf_services.scenario.build import build_node
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.parts.messages import Gripper


@pytest.mark.parametrize("scenario", ["landmark-room", "parts-3-tracked"])
def test_a_gap_is_told_in_the_log(scenario: str) -> None:
    node = build_node(load_scenario(scenario), "estimator")
    gap = HostEvent(kind="gap", topic="sensors/odometry", node="sensors", first=4, last=6)
    result = node.step(Step(0, 7, 350_000_000, (Received(GAPS, "estimator", "boot", 0, 350_000_000, gap),)))
    warnings = [output.message for output in result.outputs if isinstance(output.message, Log)]
    assert [warning.message for warning in warnings] == [
        "sensors/odometry of sensors: messages 4 to 6 did not come in time; the estimate goes on without"
    ]


def test_a_gripper_message_that_is_missing_leaves_the_part_in_the_gripper() -> None:
    node = build_node(load_scenario("parts-3-tracked"), "estimator")
    closed = Received("sensors/gripper", "sensors", "boot", 0, 0, Gripper(contact=True, theta=0.0))
    node.step(Step(0, 0, 0, (closed,)))
    node.step(Step(1, 1, 50_000_000, ()))
    assert _contact(node)
    opened = Received("sensors/gripper", "sensors", "boot", 1, 0, Gripper(contact=False, theta=0.0))
    node.step(Step(2, 2, 100_000_000, (opened,)))
    assert not _contact(node)


def _contact(node: Node) -> bool:
    return bool(node.freeze()["contact"])
