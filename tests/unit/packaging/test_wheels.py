"""What the two wheels hold, ask for and say of themselves, and that the library does without what is an extra."""

import re
import subprocess
import sys
import zipfile
from email.message import Message
from email.parser import BytesParser
from pathlib import Path
from typing import NamedTuple

import pytest

import dynpf

ROOT = Path(__file__).parents[3]
APPLICATION = {
    "protocol/dynpf_protocol",
    "formats/dynpf_formats",
    "runtime/dynpf_runtime",
    "services/dynpf_services",
    "experiments/dynpf_experiments",
    "systems/dynpf_systems",
    "scenarios/dynpf_scenarios",
    "lab/dynpf_lab",
}


class Wheel(NamedTuple):
    """The files of a wheel and its metadata."""

    files: set[str]
    metadata: Message
    entry_points: str

    @property
    def packages(self) -> set[str]:
        return {file.partition("/")[0] for file in self.files if ".dist-info/" not in file}

    def needs(self, extra: str = "") -> set[str]:
        """Return the distributions that it needs, or those that an extra brings."""
        lines = self.metadata.get_all("Requires-Dist", [])
        chosen = (line for line in lines if (f"extra == '{extra}'" in line if extra else "extra ==" not in line))
        return {re.split(r"[^\w-]", line)[0] for line in chosen}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Wheel]:
    folder = tmp_path_factory.mktemp("wheels")
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "wheel", "--no-build-isolation"]
    subprocess.run([*command, "--no-deps", "--wheel-dir", folder, ROOT, ROOT / "lab"], check=True)
    found = {}
    for path in folder.iterdir():
        with zipfile.ZipFile(path) as archive:
            inside = {file.rpartition("/")[2]: file for file in archive.namelist() if ".dist-info/" in file}
            metadata = BytesParser().parsebytes(archive.read(inside["METADATA"]))
            points = archive.read(inside["entry_points.txt"]).decode() if "entry_points.txt" in inside else ""
            found[metadata["Name"]] = Wheel(set(archive.namelist()), metadata, points)
    return found


def tracked(folder: str) -> set[str]:
    """Return the files of a package that are in the repository, by their names in a wheel."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", folder],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    parent = Path(folder).parent
    return {Path(file).relative_to(parent).as_posix() for file in listed.stdout.splitlines()}


def test_the_library_is_one_package_that_needs_numbers_and_no_bus(wheels: dict[str, Wheel]) -> None:
    library = wheels["dynpf"]
    assert library.packages == {"dynpf"}
    assert library.needs() == {"numpy", "numba", "msgspec"}
    assert library.needs("vision") == {"opencv-python-headless"}
    assert library.needs("maps") == {"opencv-python-headless", "pyyaml"}
    assert library.entry_points == ""


def test_the_application_is_the_layers_above_and_needs_this_very_library(wheels: dict[str, Wheel]) -> None:
    application = wheels["dynpf-lab"]
    assert application.packages == {Path(folder).name for folder in APPLICATION}
    needed = application.metadata.get_all("Requires-Dist", [])
    assert f"dynpf[maps,vision]=={dynpf.__version__}" in needed
    assert application.entry_points.split() == ["[console_scripts]", "dynpf", "=", "dynpf_lab.cli.main:main"]


@pytest.mark.parametrize(("name", "folders"), [("dynpf", {"dynpf"}), ("dynpf-lab", APPLICATION)])
def test_a_wheel_holds_the_files_of_the_repository_and_no_others(
    name: str, folders: set[str], wheels: dict[str, Wheel]
) -> None:
    expected = set().union(*map(tracked, folders))
    assert {file for file in wheels[name].files if ".dist-info/" not in file} == expected
    assert {f"{package}/py.typed" for package in wheels[name].packages} <= expected


@pytest.mark.parametrize("name", ["dynpf", "dynpf-lab"])
def test_a_wheel_says_who_made_it_for_whom_and_under_which_licence(name: str, wheels: dict[str, Wheel]) -> None:
    metadata = wheels[name].metadata
    assert metadata["Version"] == dynpf.__version__
    assert metadata["Author"] == "dynpf developers"
    assert metadata["License-Expression"] == "Apache-2.0"
    assert any(file.endswith(".dist-info/licenses/LICENSE") for file in wheels[name].files)
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["Keywords"]
    assert "Typing :: Typed" in metadata.get_all("Classifier", [])
    assert "Home-page" not in metadata
    assert "Project-URL" not in metadata


WITHOUT_EXTRAS = """
import importlib, sys
sys.modules.update(cv2=None, yaml=None)
import dynpf
for name in dynpf.__all__:
    getattr(dynpf, name)
for module in ("dynpf.vision", "dynpf.maps.map_server"):
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        print(error.name, error)
try:
    dynpf.maps.decode_bitmap(b"P5 1 1 255 x", "wall.pgm")
except ModuleNotFoundError as error:
    print(error.name, error)
"""


def test_all_names_of_the_library_are_there_without_extras_and_the_rest_says_which_it_needs() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "cv2 dynpf.vision needs OpenCV: pip install 'dynpf[vision]'",
        "yaml maps of map_server need PyYAML: pip install 'dynpf[maps]'",
        "cv2 images are read by OpenCV: pip install 'dynpf[vision]'",
    ]


@pytest.mark.parametrize(
    "lock", ["requirements.lock", "requirements-dev.lock", "requirements-peers.lock", "requirements-ros2.lock"]
)
def test_the_locks_name_no_package_of_ours(lock: str) -> None:
    names = re.findall(r"^[\w.-]+", (ROOT / lock).read_text(), flags=re.MULTILINE)
    assert "numpy" in names
    assert not [name for name in names if name.startswith("dynpf")]
