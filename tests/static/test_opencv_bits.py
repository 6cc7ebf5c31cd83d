"""OpenCV's functions that portable code may use give the same bits whatever instructions and libraries are beneath."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from checks.opencv_bits import CONTROL, PORTABLE
from checks.portable_names import EXACT

_CHOSEN = [name.strip("*") for name in cv2.getCPUFeaturesLine().split() if name.startswith("*") and "?" not in name]
_BASELINE = {"OPENCV_CPU_DISABLE": ",".join(_CHOSEN), "OPENCV_IPP": "disabled", "JSIMD_FORCENONE": "1"}


def _digests(**environment: str) -> dict[str, str]:
    clean = {name: value for name, value in os.environ.items() if name not in _BASELINE}
    found = subprocess.run(
        [sys.executable, "-m", "checks.opencv_bits"],
        cwd=Path(__file__).parents[2],
        env=clean | environment,
        check=True,
        capture_output=True,
    )
    digests: dict[str, str] = json.loads(found.stdout)
    return digests


@pytest.mark.skipif(not _CHOSEN, reason="OpenCV has no choice of instructions on this processor")
def test_opencv_gives_the_same_bits_with_any_instructions_and_at_any_place_in_memory() -> None:
    default, baseline = _digests(), _digests(**_BASELINE)
    assert default[CONTROL] != baseline[CONTROL]
    assert [name for name in PORTABLE if default[name] != baseline[name] or default[name] == "differs"] == []


def test_every_function_of_opencv_that_is_allowed_is_shown() -> None:
    source = (Path(__file__).parents[2] / "checks" / "opencv_bits.py").read_text()
    functions = [name for names in EXACT.values() for name in names if name.startswith("cv2.")]
    assert [name for name in functions if name[4].islower() and name != "cv2.error" and name not in source] == []
