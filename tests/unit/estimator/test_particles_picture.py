"""Particles as they are shown: to 1 mm and 1 mrad, by operations that every machine rounds alike."""

import json
import math

import msgspec
import numpy as np
import pytest
from dynpf_protocol.messages import PosesInFrame, heading, timestamp
from dynpf_services.estimates import particles_picture


def shown(*particles: tuple[float, float, float]) -> PosesInFrame:
    return particles_picture(np.array(particles).T, timestamp(0))


def test_particles_are_shown_within_half_a_millimetre_and_a_milliradian():
    particles = np.random.default_rng(1).uniform(-30.0, 30.0, (3, 200))
    particles[2] = np.remainder(particles[2], math.tau) - math.pi
    poses = particles_picture(particles, timestamp(0)).poses
    places = np.array([(pose.position.x, pose.position.y) for pose in poses]).T
    turns = np.array([heading(pose.orientation) for pose in poses]) - particles[2]
    assert np.abs(places - particles[:2]).max() <= 0.5e-3 * (1.0 + 1e-9)
    assert np.abs(np.remainder(turns + math.pi, math.tau) - math.pi).max() <= 0.65e-3
    norms = [pose.orientation.z**2 + pose.orientation.w**2 for pose in poses]
    np.testing.assert_allclose(norms, 1.0, atol=2e-4)


def test_no_number_has_more_than_four_decimals():
    particles = np.random.default_rng(2).uniform(-3.0, 3.0, (3, 200))
    text = msgspec.json.encode(particles_picture(particles, timestamp(0)))
    decimals: list[str] = []
    json.loads(text, parse_float=lambda number: decimals.append(number.partition(".")[2]))
    assert len(decimals) == 200 * 7
    assert max(map(len, decimals)) == 4


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        (0.0005, "0.0"),  # halves to the even one
        (0.0015, "0.002"),
        (-0.0015, "-0.002"),
        (-0.0004, "0.0"),  # no zero below zero
        (-0.0, "0.0"),
        (1.2344999, "1.234"),
        (123456.7891, "123456.789"),
    ],
)
def test_halves_and_zeros_are_what_they_should_be(x: float, expected: str):
    assert f'"position":{{"x":{expected},"y":'.encode() in msgspec.json.encode(shown((x, 1.0, 0.0)))


@pytest.mark.parametrize(
    ("theta", "z", "w"), [(0.0, 0.0, 1.0), (math.pi, 1.0, -0.0002), (-0.0004, 0.0, 1.0), (-1.0, -0.4794, 0.8776)]
)
def test_headings_are_rounded_to_a_milliradian_first(theta: float, z: float, w: float):
    (pose,) = shown((0.0, 0.0, theta)).poses
    assert (pose.orientation.z, pose.orientation.w) == (z, w)
