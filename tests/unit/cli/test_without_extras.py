"""Commands in an environment as `make run` leaves it, without the packages of extras."""

import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT = "import sys; sys.modules[{!r}] = None; from dynpf_lab.cli.main import main; sys.exit(main(sys.argv[1:]))"


def said(package: str, *words: str | Path) -> tuple[int, str]:
    command = [sys.executable, "-c", WITHOUT.format(package), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("bridge", "ros2", "laser-log", "--connect", "tcp/127.0.0.1:1"),
        ("record", "--connect", "tcp/127.0.0.1:1", "-o", "F.mcap"),
        ("localize", "log.bag"),
    ],
)
def test_what_reads_ros_says_what_to_install(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "log.bag").touch()
    told = said("rosbags", *(tmp_path / word if word == "log.bag" else word for word in words))
    assert told[0] == 2
    assert told[1].endswith("needs the package rosbags: pip install 'dynpf-lab[ros]'\n"), told[1]


def test_a_robot_on_dds_says_what_to_install() -> None:
    code, text = said("cyclonedds", "bridge", "ros2", "laser-log", "--dds")
    assert code == 2
    assert text.endswith("needs the package cyclonedds: pip install 'dynpf-lab[dds]'\n"), text


def test_other_logs_are_localized_without_it(tmp_path: Path) -> None:
    (tmp_path / "robot.log").write_text("FLASER 3 1 2 3\n")
    code, text = said("rosbags", "localize", tmp_path / "robot.log", "-o", tmp_path / "out")
    assert (code, "rosbags" in text, "robot.log" in text) == (2, False, True), text


def test_keys_of_zenoh_are_recorded_without_it(tmp_path: Path) -> None:
    words = ("record", "a//b", "--format", "raw", "--connect", "tcp/127.0.0.1:1", "-o", tmp_path / "F.mcap")
    code, text = said("rosbags", *words)
    assert (code, "'a//b': no key expression" in text) == (2, True), text
