"""A new system is one folder and one line: its nodes, measures and studies are found by all commands."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SYSTEMS = Path(__file__).parents[2] / "systems"
LISTED = 'SYSTEMS = ("rooms", "parts", "colon")'

FOLDER = {
    "__init__.py": """
FACTS = {}
KINDS = {
    ("simulator", "train"): "dynpf_systems.rails.nodes:TRAIN",
    ("estimator", "timetable"): "dynpf_systems.rails.nodes:TIMETABLE",
}
MEASURES = "dynpf_systems.rails.measures:MEASURES"
STUDIES = {"delays": "dynpf_systems.rails.study:STUDY"}
""",
    "nodes.py": """
import msgspec
from dynpf_protocol.messages import Estimate, RobotState
from dynpf_runtime.node import Output, Result
from dynpf_services.scenario.kinds import NodeKind


class Train(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="train"):
    speed: float = 10.0  # m/s


class Timetable(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="timetable"):
    speed: float = 10.0  # m/s
    delay: float = 0.5  # s


class Moving:
    def __init__(self, name, write):
        self.name, self._write = name, write

    def step(self, step):
        return Result((self._write(step.stamp_ns * 1e-9),))

    def freeze(self):
        return {}

    def thaw(self, state):
        pass


def train(config, context):
    return Moving(context.name, lambda t: Output("truth/robot", RobotState(x=config.speed * t, y=0.0, theta=0.0)))


def timetable(config, context):
    def write(t):
        x = config.speed * (t - config.delay)
        return Output("estimator/state", Estimate(x=x, y=0.0, theta=0.0, covariance=(0.0,) * 9, n_eff=1.0))

    return Moving(context.name, write)


TRAIN = NodeKind(Train, "dynpf_systems.rails.nodes:train", lambda *_: (), lambda *_: {"truth/robot"})
TIMETABLE = NodeKind(
    Timetable, "dynpf_systems.rails.nodes:timetable", lambda *_: {"truth/robot"}, lambda *_: {"estimator/state"}
)
""",
    "measures.py": """
from dynpf_experiments.measures import Measures
from dynpf_protocol.messages import Estimate, RobotState


def of_run(run):
    truth, estimates = run.topic("truth/robot"), run.topic("estimator/state")
    return {"late_m": truth[-1].message.x - estimates[-1].message.x} if truth and estimates else {}


MEASURES = Measures(
    estimate=Estimate,
    reads=(RobotState, Estimate),
    truths=("truth/robot",),
    of_run=of_run,
    lines=lambda measures: [f"late        {measures['late_m']:.1f} m"] if "late_m" in measures else [],
)
""",
    "study.py": """
from dynpf_experiments.sweep import sweep

STUDY = sweep(scenario="rails.toml", grid={"estimator.delay": (0.5, 2.0)}, measures=["late_m"], trials=2)
""",
}
SCENARIO = """
title = "A train by its timetable"
max_ticks = 5
[simulator]
kind = "train"
[estimator]
kind = "timetable"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a copy of the systems and one more, and with a scenario of it."""
    systems = shutil.copytree(SYSTEMS, tmp_path / "systems", ignore=shutil.ignore_patterns("__pycache__"))
    listing = systems / "dynpf_systems" / "__init__.py"
    assert LISTED in listing.read_text()
    listing.write_text(listing.read_text().replace(LISTED, LISTED.replace(")", ', "rails")')))
    rails = systems / "dynpf_systems" / "rails"
    rails.mkdir()
    for name, text in FOLDER.items():
        (rails / name).write_text(text)
    (tmp_path / "rails.toml").write_text(SCENARIO)
    return tmp_path


def said(folder: Path, *words: str) -> str:
    command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", *words]
    environment = {**os.environ, "PYTHONPATH": str(folder / "systems")}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=240, cwd=folder, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_folder_and_a_name_are_a_system(folder: Path) -> None:
    told = said(folder, "run", "rails.toml", "-o", "run.mcap")
    assert "late        5.0 m" in told
    assert "position    RMSE 5.0000 m" in told
    assert json.loads(said(folder, "metrics", "run.mcap", "--json"))["late_m"] == 5.0
    assert json.loads(said(folder, "replay", "run.mcap", "--json"))["same"] is True
    rows = json.loads(said(folder, "study", "delays", "--jobs", "1", "--json"))["rows"]
    assert [(row["estimator.delay"], row["late_m_mean"]) for row in rows] == [(0.5, 5.0), (2.0, 20.0)]
    assert "timetable" in said(folder, "schema")
