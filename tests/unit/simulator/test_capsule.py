"""The capsule simulator and its sensors: the route, the maps in force, and ranges in the map that is true."""

import math
from typing import Any

import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import SceneUpdate
from dynpf_runtime.node import Received, Step
from dynpf_systems.colon.config import CapsuleConfig, CapsuleSensorsConfig
from dynpf_systems.colon.messages import CapsuleMove, CapsuleReading, CapsuleState
from dynpf_systems.colon.sensors import CapsuleSensors
from dynpf_systems.colon.simulator import CapsuleSimulator
from dynpf_systems.colon.tube import ColonConfig, ColonWorld, MapHolds

from dynpf.colon import ROUTE
from dynpf.colon.beams import expected_ranges
from dynpf.maps.raycast import RayCaster

CHANGES = (MapHolds(map="a"), MapHolds(map="b", from_reading=8))


@pytest.fixture(name="world", scope="module")
def made_world() -> ColonWorld:
    return ColonWorld(ColonConfig(family="folds", tube=3, true=CHANGES), ())


def driven(world: ColonWorld, seed: int = 1, **noise: float) -> list[CapsuleState]:
    simulator = CapsuleSimulator(config=CapsuleConfig(**noise), seed=seed, world=world)
    states = []
    for tick in range(len(ROUTE.motions) + 1):
        result = simulator.step(Step(tick, tick, tick * 10**9, ()))
        state = next(one.message for one in result.outputs if one.topic == "truth/capsule")
        assert isinstance(state, CapsuleState)
        states.append(state)
        assert result.finished == (tick == len(ROUTE.motions))
    return states


def sensed(world: ColonWorld, states: list[CapsuleState], seed: int = 1, **noise: float) -> list[CapsuleReading]:
    sensors = CapsuleSensors(config=CapsuleSensorsConfig(**noise), seed=seed, world=world)
    readings: list[Any] = []
    for tick, state in enumerate(states):
        received = Received("truth/capsule", "simulator", "boot", tick, tick * 10**9, state)
        readings += [one.message for one in sensors.step(Step(tick, tick, tick * 10**9, (received,))).outputs]
    return readings


def poses_of(states: list[CapsuleState]) -> np.ndarray:
    return np.array([(one.x_px, one.y_px, one.theta) for one in states]).T


def test_a_capsule_without_noise_keeps_to_its_route_while_the_map_changes(world: ColonWorld) -> None:
    states = driven(world)
    np.testing.assert_allclose(poses_of(states), ROUTE.poses(), atol=1e-9)
    assert "".join(one.map for one in states) == "a" * 8 + "b" * 8
    assert [one.reading for one in states] == list(range(16))
    moves = [one.move for one in states[1:]]
    assert [(one.rho_px, one.turn) for one in moves if isinstance(one, CapsuleMove)] == list(map(tuple, ROUTE.motions))


def test_a_noisy_capsule_is_steered_to_its_route_and_tells_what_it_was_told(world: ColonWorld) -> None:
    states = driven(world, sigma_px=1.0, sigma_theta=0.1)
    off = np.hypot(*(poses_of(states) - ROUTE.poses())[:2, 1:])
    assert 0.3 < off.mean() < 20.0
    assert states != driven(world, seed=2, sigma_px=1.0, sigma_theta=0.1)
    goal, before, move = ROUTE.poses()[:, 15], states[14], states[15].move
    assert isinstance(move, CapsuleMove)
    assert move.rho_px == pytest.approx(math.hypot(goal[0] - before.x_px, goal[1] - before.y_px))


def test_ranges_are_those_of_the_map_that_is_true_at_the_time(world: ColonWorld) -> None:
    states = driven(world)
    read = np.array([one.ranges_px for one in sensed(world, states)]).T
    poses = poses_of(states).astype(np.float32)
    before, after = (expected_ranges(RayCaster(world.grid(name, "")), poses) for name in "ab")
    np.testing.assert_allclose(read[:, :8], before[:, :8], atol=1e-3)
    np.testing.assert_allclose(read[:, 8:], after[:, 8:], atol=1e-3)
    assert np.abs(read - before).max() > 10.0, "the control: the change is one that can be seen"


def test_ranges_have_the_noise_and_the_outliers_that_were_asked_for(world: ColonWorld) -> None:
    states = driven(world) * 20
    states = [CapsuleState(reading=n, x_px=s.x_px, y_px=s.y_px, theta=s.theta, map="a") for n, s in enumerate(states)]
    exact, noisy, wild = (
        np.array([one.ranges_px for one in sensed(world, states, 1, **noise)])
        for noise in ({}, {"sigma_range_px": 3.0}, {"outlier_fraction": 0.1})
    )
    free = (exact > 15.0) & (exact < 485.0)  # not clipped
    assert np.std((noisy - exact)[free]) == pytest.approx(3.0, rel=0.05)
    assert np.mean(np.abs(wild - exact) > 1e-9) == pytest.approx(0.1, abs=0.03)


def test_the_scene_shows_the_map_in_force(world: ColonWorld) -> None:
    simulator = CapsuleSimulator(config=CapsuleConfig(), seed=1, world=world)
    scenes = []
    for tick in range(10):
        told = simulator.step(Step(tick, tick, tick * 10**9, ())).outputs
        scenes += [one.message for one in told if isinstance(one.message, SceneUpdate)]
    tubes = [scene.entities[0] for scene in scenes]
    assert [tube.texts[0].text for tube in tubes] == ["true map: a"] * 8 + ["true map: b"] * 2
    assert tubes[0].lines == tubes[7].lines != tubes[8].lines
    right = max(point.x for line in tubes[8].lines for point in line.points)
    free = np.flatnonzero(world.grid("b", "").free.any(axis=0))
    assert right == pytest.approx(0.01 * free.max(), abs=0.02)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (ColonConfig(true=(MapHolds(map="q"),)), "colon.true: map 'q': expected one of a, b, c"),
        (ColonConfig(true=(MapHolds(map="end x"),)), "colon.true: map 'end x': expected one of"),
        (ColonConfig(true=(MapHolds(map="end 60"),)), "colon.true: end 60: "),
    ],
)
def test_a_map_that_cannot_be_made_is_told(config: ColonConfig, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        CapsuleSimulator(config=CapsuleConfig(), seed=1, world=ColonWorld(config, ()))


def test_maps_must_come_in_order_of_time() -> None:
    with pytest.raises(ScenarioError, match=r"colon.true: map 1 starts at 0.0"):
        ColonWorld(ColonConfig(true=(MapHolds(map="a"), MapHolds(map="b"))), ())
