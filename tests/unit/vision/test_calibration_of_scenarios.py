"""A scenario says how vision is calibrated, and not otherwise than its camera stands."""

from pathlib import Path

import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.parts.camera_model import CameraParams, calibration_pairs

PARTS = ("parts-3-easy", "parts-3-intermediate", "parts-3-hard", "parts-6-easy", "parts-6-intermediate", "parts-6-hard")

WITHOUT = """
title = "A camera, and vision that is not told how it stands"
tick_s = 0.05
[task]
parts = [{ radius = 0.06, goal = [0.0, 0.55] }]
[simulator]
kind = "workspace"
[simulator.camera]
[vision]
"""


@pytest.mark.parametrize("name", PARTS)
def test_the_points_that_come_along_are_those_of_the_default_camera(name: str) -> None:
    points = load_scenario(name).nodes["vision"].calibration
    assert points == tuple(tuple(pair) for pair in calibration_pairs(CameraParams()))


@pytest.mark.parametrize(
    ("name", "overrides", "complaint"),
    [
        (
            "parts-3-easy",
            ["simulator.camera.tilt_x_rad=0.1"],
            r"vision\.calibration: its points lie up to 13\.5 px from",
        ),
        ("parts-3-easy", ["vision.calibration={kind='board'}"], r"vision\.calibration: a board, but .* shows none"),
        (
            "parts-3-lens",
            ["simulator.camera.board={kind='board', half_rows=2}"],
            r"vision\.calibration: a board, but .* shows another",
        ),
    ],
)
def test_a_calibration_that_does_not_fit_the_simulated_camera_is_refused(
    name: str, overrides: list[str], complaint: str
) -> None:
    with pytest.raises(ScenarioError, match=complaint):
        load_scenario(name, overrides=overrides)


def test_vision_without_a_calibration_is_told_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(WITHOUT)
    with pytest.raises(ScenarioError, match=r"vision\.calibration: missing; write known points as \[\[u_px, v_px, x_m"):
        load_scenario(str(tmp_path / "scenario.toml"))


def test_control_a_camera_that_hardly_differs_and_one_that_only_sees_other_colours_are_none() -> None:
    load_scenario("parts-3-easy", overrides=["simulator.camera.rotation_rad=0.022", "simulator.camera.noise_std=5"])
