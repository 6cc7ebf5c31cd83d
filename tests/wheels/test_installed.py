"""The wheels in fresh environments: the library with the oldest and the newest packages, and the application.

`make test-wheels` runs these and shows what they print; a package index has to be in reach.
"""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

pytestmark = [pytest.mark.wheels, pytest.mark.timeout(1800)]

ROOT = Path(__file__).parents[2]
UV = Path(sys.executable).with_name("uv")
TOOLS = ("hypothesis", "mpmath", "pytest", "pytest-timeout", "scipy")
OTHERS = re.compile(r"^ *(from|import) (dynpf_|docs|checks|benchmarks)", re.MULTILINE)

ENVIRONMENTS = {
    "oldest, Python 3.11": ("3.11", ("--resolution", "lowest", "--only-binary", ":all:")),
    "oldest, Python 3.12": ("3.12", ("--resolution", "lowest", "--only-binary", ":all:")),
    "ROS 2 Jazzy": ("3.12", ("numpy==1.26.4", "pyyaml==6.0.1", "opencv-python-headless==4.6.0.66")),
    "newest, Python 3.13": ("3.13", ()),
}


def run(command: Sequence[object], cwd: Path, env: Mapping[str, str] | None = None) -> str:
    """Return what a command prints; a failure shows all of it."""
    usual = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA", "VIRTUAL"))}
    words = [str(word) for word in command]
    done = subprocess.run(
        words, check=False, capture_output=True, text=True, timeout=1500, cwd=cwd, env={**usual, **(env or {})}
    )
    assert done.returncode == 0, f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


class Environment:
    """A virtual environment and what is installed in it."""

    def __init__(self, folder: Path, python: str) -> None:
        self.folder = folder
        self.python = folder / "bin" / "python"
        run([UV, "--quiet", "venv", "--python", python, folder], folder.parent)

    def install(self, *words: object) -> None:
        run(
            [UV, "--quiet", "pip", "install", "--compile-bytecode", "--python", self.python, *words], self.folder.parent
        )

    @property
    def versions(self) -> dict[str, str]:
        listed = run([UV, "pip", "list", "--format", "json", "--python", self.python], self.folder.parent)
        return {row["name"]: row["version"] for row in json.loads(listed)}

    def files_of(self, distribution: str) -> set[str]:
        """Return what a distribution has put into site-packages."""
        code = (
            f"from importlib.metadata import files; print(*{{p.parts[0] for p in files({distribution!r})}}, sep='\\n')"
        )
        return set(run([self.python, "-c", code], self.folder.parent).split())


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The wheels of the library and of the application."""
    folder = tmp_path_factory.mktemp("wheels")
    command = [sys.executable, "-m", "pip", "--quiet", "wheel", "--no-build-isolation", "--no-deps"]
    run([*command, "--wheel-dir", folder, ROOT, ROOT / "lab"], ROOT)
    return sorted(folder.iterdir())


@pytest.fixture(scope="module", params=list(ENVIRONMENTS))
def library(
    request: pytest.FixtureRequest, wheels: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Environment:
    python, words = ENVIRONMENTS[request.param]
    environment = Environment(tmp_path_factory.mktemp("library") / "venv", python)
    environment.install(f"dynpf[maps,vision] @ {wheels[0].as_uri()}", *words)
    return environment


def of_the_library(path: Path) -> bool:
    """Return whether a file tests the library and needs nothing else of the repository."""
    source = path.read_text()
    return "dynpf" in source and not OTHERS.search(source) and path.parent.name != "packaging"


def example() -> str:
    """The filter of the README."""
    found: str
    (found,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    return found


def test_the_library_alone_is_added_and_its_tests_pass(library: Environment, tmp_path: Path) -> None:
    before = library.versions
    assert library.files_of("dynpf") == {"dynpf", f"dynpf-{before['dynpf']}.dist-info"}
    held = tmp_path / "held.txt"
    held.write_text("\n".join(f"{name}=={version}" for name, version in before.items() if name != "dynpf"))
    library.install(*TOOLS, "--constraints", held)

    files = [path for path in sorted((ROOT / "tests/unit").glob("**/test_*.py")) if of_the_library(path)]
    (tmp_path / "tests").symlink_to(ROOT / "tests")  # what tests share; beside it the library would be the checkout's
    options = ["--import-mode=importlib", "-p", "no:cacheprovider", "--config-file", os.devnull, "--rootdir", ROOT]
    told = run(
        [library.python, "-P", "-m", "pytest", "--quiet", *options, *files], tmp_path, {"PYTHONPATH": str(tmp_path)}
    )
    packages = ("numpy", "numba", "msgspec", "opencv-python-headless", "pyyaml")
    print(", ".join(f"{name} {before[name]}" for name in packages), "-", told.strip().splitlines()[-1])


def test_the_filter_of_the_readme_runs_and_tells_its_time(library: Environment, tmp_path: Path) -> None:
    (tmp_path / "example.py").write_text(example())
    first = run([library.python, "example.py"], tmp_path)  # compiles the kernels
    began = time.perf_counter()
    assert run([library.python, "example.py"], tmp_path) == first
    took = time.perf_counter() - began
    clock = "import time; t = time.perf_counter(); import dynpf; print(time.perf_counter() - t)"
    imported = float(run([library.python, "-c", clock], tmp_path))
    print(f"import dynpf: {imported:.3f} s; the interpreter, the library and the first update: {took:.2f} s; {first}")


WRONG = """
from dynpf import Arcs, ArcsParams, Wheel

Arcs(ArcsParams(along_variance_per_m="much")).propagate(1, 2, 3)
"""


def test_a_users_type_checker_finds_types(library: Environment, tmp_path: Path) -> None:
    library.install("mypy")
    (tmp_path / "example.py").write_text(f"{example()}\nreveal_type(report.estimate.mean)\nreveal_type(robot)\n")
    (tmp_path / "wrong.py").write_text(WRONG)
    mypy = [str(library.python), "-m", "mypy", "--strict"]
    told = run([*mypy, "example.py"], tmp_path)
    assert re.search(r'"numpy\.ndarray\[.*numpy\.float', told)
    assert '"dynpf.filters.particle.ParticleFilter' in told
    wrong = subprocess.run([*mypy, "wrong.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert 'Module "dynpf" has no attribute "Wheel"' in wrong.stdout
    assert wrong.stdout.count("[arg-type]") == 4


@pytest.fixture(scope="module")
def application(wheels: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """Python as it is here, with the newest packages that the application takes."""
    environment = Environment(tmp_path_factory.mktemp("application") / "venv", "{}.{}".format(*sys.version_info[:2]))
    environment.install(*wheels)
    return environment


def landmark_room(application: Environment, folder: Path, env: Mapping[str, str] | None = None) -> None:
    dynpf = application.folder / "bin" / "dynpf"
    told = json.loads(run([dynpf, "run", "landmark-room", "--json", "-o", "RUN.mcap"], folder, env))
    assert told["complete"]
    assert told["position_rmse_m"] < 0.1
    run([dynpf, "replay", "RUN.mcap"], folder, env)


def test_the_application_puts_no_name_but_its_own_into_other_peoples_way(application: Environment) -> None:
    found = application.files_of("dynpf-lab") - {"..", "__pycache__"}  # .. leads to the command
    assert all(name.startswith("dynpf_") for name in found)


def test_a_scenario_runs_from_an_empty_folder(application: Environment, tmp_path: Path) -> None:
    landmark_room(application, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["RUN.html", "RUN.mcap"]


@pytest.mark.parametrize("name", ["services", "protocol", "scenarios", "numpy_utils"])
def test_folders_of_a_users_own_are_in_nobodys_way(name: str, application: Environment, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("raise RuntimeError('mine')\n")
    path = {"PYTHONPATH": str(tmp_path)}
    # The folder is really found.
    mine = subprocess.run(
        [application.python, "-c", f"import {name}"],
        cwd=tmp_path,
        env=path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "RuntimeError: mine" in mine.stderr
    landmark_room(application, tmp_path, path)
