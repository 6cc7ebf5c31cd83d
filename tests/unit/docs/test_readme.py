"""The examples of the README and of the library's page run, and the library's surface is what it says."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import dynpf
from docs.readme import README, printed_by_make_run, with_figures
from dynpf.se2 import wrap_angle

ROOT = Path(__file__).parents[3]


def examples(page):
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)


def test_the_filter_of_the_readme_follows_its_robot():
    (example,) = examples("README.md")
    assert len([line for line in example.splitlines() if line.strip()]) <= 15
    names: dict[str, Any] = {"print": lambda *_: None}
    exec(example, names)
    # An arc of half a metre that turns by 0.1 rad.
    np.testing.assert_allclose(names["report"].estimate.mean, [0.499, 0.025, 0.1], atol=0.1)
    assert names["report"].n_eff > 10.0


def test_the_readme_shows_what_its_first_command_prints():
    page = README.read_text()
    assert with_figures(page, printed_by_make_run()) == page, "make docs writes the figures anew"


class Bearing(NamedTuple):
    heading: float


def test_the_model_of_the_librarys_page_steers_a_filter():
    (example,) = examples("docs/library.md")
    names: dict[str, Any] = {"np": np, "wrap_angle": wrap_angle}
    exec(example, names)
    filter_ = dynpf.ParticleFilter(dynpf.Arcs(dynpf.ArcsParams()), {Bearing: names["Compass"](0.1)})
    start = dynpf.start_poses(dynpf.KnownStart(sigma_heading=1.0), 5000, dynpf.Stream.of(1, "test", 0))
    cloud = filter_.start(start, dynpf.Stream.of(2, "test", 0))
    _, report = filter_.update(cloud, None, [Bearing(0.7)], dynpf.Stream.of(1, "test", 1))
    # The product of N(0, 1) and N(0.7, 0.1^2).
    assert abs(report.estimate.mean[2] - 0.7 / 1.01) < 0.01


def test_the_examples_of_the_notebooks_page_run_one_after_another(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"print": lambda *_: None}
    found = examples("docs/notebooks.md")
    assert len(found) >= 6
    for example in found:
        exec(example, names)
    assert names["fields"]["covariance"].shape == (300, 9)
    assert names["again"].digest == names["made"].digest


@pytest.mark.parametrize("name", dynpf.__all__)
def test_every_name_of_the_surface_is_there_and_documented(name):
    assert getattr(dynpf, name).__doc__


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Wheel'"):
        _ = dynpf.Wheel  # type: ignore[attr-defined]


def test_the_surface_loads_without_the_compiler():
    code = (
        "import sys; from dynpf import *; assert 'dynpf.filters.particle' in sys.modules; print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
