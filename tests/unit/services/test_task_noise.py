"""``task.noise`` is one setting for the motion, for what is measured, and for what the filters expect."""

import math

import numpy as np
import pytest
from dynpf_runtime.node import Received, Step
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.parts.task import NOISE

TICK_NS = 50_000_000


def stepped(node, tick, outputs=()):
    stamp = tick * TICK_NS
    inputs = tuple(Received(one.topic, "", "", tick, stamp, one.message) for one in outputs)
    return node.step(Step(tick, tick, stamp, inputs)).outputs


def nodes(name, *overrides):
    return build_nodes(load_scenario(name, overrides=overrides))


def centres(discs):
    return {round(disc.radius, 2): (disc.x, disc.y) for disc in discs}


@pytest.mark.parametrize("level", NOISE)
def test_motion_and_tracker_have_the_noise_of_the_level(level):
    run = nodes("parts-3-tracked", f"task.noise={level}")
    places, errors = [], []
    for tick in range(150):
        truth = stepped(run["simulator"], tick)
        places.append((truth[0].message.x, truth[0].message.y))
        sensed = {one.topic: one.message for one in stepped(run["sensors"], tick, truth)}
        seen = centres(sensed["sensors/overhead"].discs)
        errors.append(np.subtract(seen[0.1], places[-1]))
    assert np.std(errors) == pytest.approx(math.sqrt(NOISE[level].measurement), rel=0.15)
    assert np.std(np.diff(places, axis=0)) == pytest.approx(math.sqrt(NOISE[level].process), rel=0.15)


def test_vision_has_it_unless_its_own_table_says_otherwise():
    found = {}
    for words in ("task.noise=none", "task.noise=high", "vision.position_noise_m=0"):
        run = nodes("parts-3-easy", words)
        [image] = [one for one in stepped(run["simulator"], 0) if one.topic == "camera/image"]
        found[words] = centres(stepped(run["vision"], 0, [image])[0].message.discs)
    assert found["task.noise=none"] == found["vision.position_noise_m=0"]
    apart = [math.dist(place, found["task.noise=high"][size]) for size, place in found["task.noise=none"].items()]
    assert len(apart) == 4
    assert 0.005 < np.mean(apart) < 0.08  # a deviation of 2.2 cm in each coordinate


def test_filters_expect_it_and_a_little_of_what_nothing_is_without():
    for level, (process, measurement) in NOISE.items():
        scenario = load_scenario("parts-6-hard", overrides=[f"task.noise={level}"])
        expected = scenario.estimator.noise(scenario.task)
        assert process <= expected.process <= process + 1e-8
        assert expected.measurement == pytest.approx(measurement + 0.0005**2)
    told = load_scenario("parts-6-hard", overrides=["estimator.measurement_variance=1e-3"])
    assert told.estimator.noise(told.task) == (NOISE["low"].process, 1e-3)
