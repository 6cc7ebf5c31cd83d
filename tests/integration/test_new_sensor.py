"""A sensor that nothing here names, from a repository of its own: simulated and estimated in at most three files.

It is made twice: from outside, as classes beside a scenario; and in the tree, as one more entry in a system's list, in
a copy of the systems that is imported in the place of ours.
"""

import ast
import difflib
import json
import os
import shutil
import subprocess
import sys
from itertools import chain
from pathlib import Path

import dynpf_systems
import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

DYNPF = Path(sys.executable).with_name("dynpf")
FILES, GLUE = 3, 15

WORLD = """\
title = "A robot whose wheels mislead it"
tick_s = 0.1
max_ticks = 120

[simulator]
kind = "room"
width = 10.0
height = 6.0
start = [-4.0, -2.0, 0.0]
driver = { points = [[4.0, -2.0], [4.0, 2.0], [-4.0, 2.0]] }

[estimator]
kind = "localization"
n = 300
start = { kind = "known", x = -4.0, y = -2.0, theta = 0.0 }
motion = { kind = "arcs", turn_variance_per_m = 0.02 }

[sensors]
kind = "simulated"
odometry = { w_bias = 0.05 }
"""
MODEL = """\
    def __init__(self, params):
        self.params = params

    def admit(self, particles, weights, reading):
        return reading

    def log_likelihood(self, particles, reading):
        error = wrap_angle(particles[2] - reading.theta) / self.params.std
        return (-0.5 * (error * error)).astype(particles.dtype)
"""

OUTSIDE = {
    "compass.py": f'''\
"""A compass, and how its readings are weighed."""

import msgspec
from dynpf_lab import Message, Sensor

from dynpf.se2 import wrap_angle


class Heading(Message, frozen=True, kw_only=True):
    schema_name = "compass.Heading"
    theta: float  # rad


class Compass(Sensor, frozen=True, kw_only=True):
    topic = "heading"
    message = Heading
    std: float = 0.02  # rad

    def sense(self, truth, draws):
        return Heading(theta=truth.theta + self.std * float(draws.standard_normal()))


class HeadingModel:
    reading = Heading

    class Params(msgspec.Struct, frozen=True):
        std: float = 0.03  # rad

{MODEL}
''',
    "compass.toml": f"""{WORLD}
[nodes.compass]
kind = "compass:Compass"
[[estimator.measurement]]
kind = "compass:HeadingModel"
""",
}

SENSORS = "dynpf_systems/rooms/sensors"
INSIDE = {
    f"{SENSORS}/heading.py": f'''\
"""Headings with Gaussian errors."""

import msgspec

from dynpf.se2 import wrap_angle


class HeadingParams(msgspec.Struct, frozen=True, tag_field="kind", tag="heading"):
    std: float = 0.03  # rad


class HeadingModel:
{MODEL}
''',
    f"{SENSORS}/compass.py": f'''\
"""A compass."""

from dynpf_protocol.messages import Message
from dynpf_services.sensors.kind import ModelKind, SensorKind, SensorTable, Simulated

from {SENSORS.replace("/", ".")}.heading import HeadingModel, HeadingParams


class Heading(Message, frozen=True, kw_only=True):
    """Which way the robot looks."""

    schema_name = "compass.Heading"
    theta: float  # rad


class CompassSensor(SensorTable, frozen=True, kw_only=True):
    std: float = 0.02  # rad


def _made(sensor, context):
    return lambda truth, draws: Heading(theta=truth.robot.theta + sensor.std * float(draws.standard_normal()))


COMPASS = SensorKind(
    name="compass",
    message=Heading,
    simulated=Simulated(CompassSensor, _made),
    models=(ModelKind(HeadingParams, Heading, HeadingModel),),
)
''',
    "compass.toml": f"""{WORLD}compass = {{ std = 0.02 }}

[[estimator.measurement]]
kind = "heading"
""",
}


def dynpf(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command; a package in ``cwd`` comes before an installed one of its name."""
    path = os.pathsep.join(filter(None, [str(cwd), os.environ.get("PYTHONPATH")]))
    command, environment = [str(DYNPF), *map(str, words)], {**os.environ, "PYTHONPATH": path}
    return subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=cwd, check=False, env=environment)


@pytest.fixture(name="outside")
def repository_outside(tmp_path: Path) -> Path:
    for name, text in OUTSIDE.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture(name="inside")
def repository_inside(tmp_path: Path) -> Path:
    (ours,) = dynpf_systems.__path__
    shutil.copytree(ours, tmp_path / "dynpf_systems", ignore=shutil.ignore_patterns("__pycache__"))
    for name, text in INSIDE.items():
        (tmp_path / name).write_text(text)
    listing = tmp_path / SENSORS / "__init__.py"
    first, rest = listing.read_text().split("\n\n", 1)
    imported = f"from {SENSORS.replace('/', '.')}.compass import COMPASS\n"
    listing.write_text(f"{first}\n\n{imported}{rest.replace('SENSORS = (', 'SENSORS = (COMPASS, ')}")
    return tmp_path


def glue_of_module(text: str) -> int:
    """Return the lines that say where things belong: imports of ours but the library, and what names are given."""
    module = ast.parse(text)
    bodies = [module.body, *(node.body for node in ast.walk(module) if isinstance(node, ast.ClassDef))]
    lines = 0
    for node in chain.from_iterable(bodies):
        imported = isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dynpf_")
        if imported or isinstance(node, ast.Assign):
            lines += (node.end_lineno or node.lineno) - node.lineno + 1
    return lines


def added(before: str, after: str) -> int:
    """Return how many lines that are not blank there are in the one text that are not in the other."""
    difference = difflib.ndiff(before.splitlines(), after.splitlines())
    return sum(line.startswith("+ ") and bool(line[2:].strip()) for line in difference)


def glue_of(files: dict[str, str]) -> int:
    modules = sum(glue_of_module(text) for name, text in files.items() if name.endswith(".py"))
    return modules + added(WORLD, files["compass.toml"])


def run(folder: Path, runner: str, *words: object) -> str:
    path = f"{runner}.mcap"
    (folder / path).unlink(missing_ok=True)
    done = dynpf("run", "compass.toml", "--runner", runner, "-o", path, *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    return content_digest(read_recording(folder / path))


def heading_error(folder: Path, *words: object) -> float:
    run(folder, "inline", *words)
    error: float = json.loads(dynpf("metrics", "inline.mcap", "--json", cwd=folder).stdout)["heading_rmse_rad"]
    return error


def test_from_outside_it_takes_two_files_and_runs_alike_on_the_bus_inline_and_replayed(outside: Path) -> None:
    assert len(OUTSIDE) <= FILES
    assert glue_of(OUTSIDE) <= GLUE
    digest = run(outside, "inline")
    assert run(outside, "bus") == digest
    replayed = dynpf("replay", "bus.mcap", "--json", "--code", ".", "--allow-code", "compass", cwd=outside)
    assert json.loads(replayed.stdout)["same"] is True, replayed.stderr
    assert heading_error(outside) < 0.03
    assert heading_error(outside, "--set", "estimator.measurement.0.std=100.0") > 0.1  # the control: it is not believed


def test_in_the_tree_it_takes_three_files_and_an_entry_in_a_list_and_replays(inside: Path) -> None:
    (ours,) = dynpf_systems.__path__
    before = {path.relative_to(ours): path.read_text() for path in sorted(Path(ours).rglob("*.py"))}
    copy = inside / "dynpf_systems"
    after = {path.relative_to(copy): path.read_text() for path in sorted(copy.rglob("*.py"))}
    entries = sum(added(text, after[path]) for path, text in before.items())
    assert len(INSIDE) == len(after.keys() - before.keys()) + 1 <= FILES
    assert 0 < entries < glue_of(INSIDE) + entries <= GLUE
    run(inside, "inline")
    recording = read_recording(inside / "inline.mcap")
    assert sum(1 for _ in recording.messages("sensors/compass")) == 120
    replayed = dynpf("replay", "inline.mcap", "--json", cwd=inside)
    assert json.loads(replayed.stdout)["same"] is True, replayed.stderr
    assert heading_error(inside) < 0.03


def test_the_count_would_notice_more_glue() -> None:
    more = OUTSIDE["compass.py"] + "from dynpf_protocol.topics import TOPICS\nTOPICS = {\n    **TOPICS,\n}\n"
    assert glue_of_module(more) == glue_of_module(OUTSIDE["compass.py"]) + 4
    assert added("a\nb\n", "a\n\nc\nb\n") == 1
