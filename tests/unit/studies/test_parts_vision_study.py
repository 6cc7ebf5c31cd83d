"""How exact the camera is that parts-vision measures, and what its rows are called."""

import numpy as np
import pytest
from dynpf_experiments.rows import Sample
from dynpf_systems.parts.studies.vision import CAMERAS, STUDY, calibrated_node, frame_errors


@pytest.mark.parametrize("name", ["plain", "lens and light"])
def test_a_calibrated_camera_is_exact_to_a_third_of_a_millimetre(name: str) -> None:
    camera = CAMERAS[name]
    node = calibrated_node(camera, 1)
    errors, invented = frame_errors(node, camera, 1, 1)
    assert errors.shape == (4, 3)
    assert invented == 0
    assert np.abs(errors).max() < 0.33e-3


def test_a_camera_that_was_calibrated_through_another_lens_is_not() -> None:
    errors, invented = frame_errors(calibrated_node(CAMERAS["plain"], 1), CAMERAS["lens"], 1, 1)
    assert invented > 0 or np.abs(errors).max() > 2e-3


def test_rows_keep_runs_and_views_apart() -> None:
    run = {"parts": 3, "goals": "H", "noise": "low", "n": 100}
    samples = [
        Sample(run, {"completed_25mm_percent": True, "npl": 1.1}),
        Sample(run, {"completed_25mm_percent": False, "npl": 1.3}),
        *(Sample({"view": f"frames: {name}"}, {"centre_error_mm": 0.1}) for name in CAMERAS),
    ]
    rows = STUDY.rows(samples)
    assert [row["goals"] for row in rows if "goals" in row] == ["H", "all"]
    assert rows[0]["completed_25mm_percent"] == 50.0
    assert rows[0]["npl_mean"] == pytest.approx(1.2)
    assert [row["view"] for row in rows if "view" in row] == [f"frames: {name}" for name in CAMERAS]
