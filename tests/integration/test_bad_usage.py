"""Bad input on the command line: one clear line that names what is wrong, and exit code 2, or 1 where a run failed."""

import os
import re
import socket
import subprocess
import sys

import pytest
from dynpf_lab.cli.main import main
from dynpf_runtime.bus.processes import free_port

from tests.integration.processes import DATA, ROOT

RUN = ["run", "landmark-room", "--set", "max_ticks=5"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A short whole recording."""
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    assert main(["run", "landmark-room", "--set", "max_ticks=20", "--runner", "inline", "-o", str(path)]) == 0
    return path


def assert_one_line(told, code, *parts):
    assert told.code == code, told
    assert told.err.count("\n") == 1, told.err
    assert told.err.startswith("dynpf")
    for part in parts:
        assert str(part) in told.err, told.err


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["run", "parts-3-esay"], ["unknown scenario 'parts-3-esay'", "did you mean 'parts-3-easy'?"]),
        (["run", "no/such.toml"], ["no/such.toml", "no such file"]),
        ([*RUN, "--set", "estimator.filtre=sir"], ["estimator.filtre", "did you mean 'filter'?"]),
        ([*RUN, "--set", "estimator.n=many"], ["estimator.n", '"many"', "expected `int`"]),
        ([*RUN, "--set", "sensors.odometry.v_std=-0.1"], ["sensors.odometry.v_std", "-0.1", ">= 0"]),
        ([*RUN, "--set", "estimator"], ["--set estimator", "expected key=value"]),
        ([*RUN, "--log", "no.mcap"], ["no.mcap", "no such file"]),
        (["run", "landmark-mrclam"], ["--log IN.mcap"]),
        (["info", "no.mcap"], ["no.mcap", "no such file"]),
        (["rnu"], ["unknown command 'rnu'", "did you mean 'run'?"]),
        ([*RUN, "--seed", "abc"], ["--seed", "'abc': expected a whole number", "--help"]),
        ([*RUN, "--sed", "1"], ["--sed", "did you mean --seed?"]),
    ],
)
def test_wrong_words_are_refused(words, parts, here):
    assert_one_line(here(*words), 2, *parts)


def test_a_scenario_file_with_bad_keys_is_refused_with_its_name(tmp_path, here):
    text = (ROOT / "scenarios" / "dynpf_scenarios" / "landmark-room.toml").read_text()
    path = tmp_path / "mine.toml"
    for good, bad, parts in (
        ("tick_s", "tick", ["tick: unknown key", "'tick_s'"]),
        ("n = 500", "n = 'x'", ["estimator.n"]),
        ("range_std = 0.03", "range_std = -1.0", ["sensors.landmarks.range_std", "-1.0"]),
        ("[simulator]", "[simulator", ["line"]),
    ):
        path.write_text(text.replace(good, bad, 1))
        assert_one_line(here("run", path), 2, path, *parts)
    path.write_text("")
    assert_one_line(here("run", path), 2, path, "title")


def test_damaged_and_foreign_files_are_refused(tmp_path, recorded, here):
    whole = recorded.read_bytes()
    middle = len(whole) // 2
    files = {
        "empty": b"",
        "text": b"not a recording\n",
        "truncated": whole[:middle],
        "flipped": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
    }
    for name, data in files.items():
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(data)
        for words in (["replay", path], ["metrics", path], ["run", "landmark-mrclam", "--log", path]):
            assert_one_line(here(*words), 2, path)
        doctor = here("doctor", path)
        assert doctor.code == (2 if name in {"empty", "text"} else 1)
        assert doctor.out
    assert here("doctor", recorded).code == 0
    assert here("replay", recorded).code == 0


def test_a_foreign_mcap_is_refused(here):
    path = DATA / "mcap" / "lichtblick" / "example.mcap"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    for command in ("info", "replay", "metrics", "diff", "play"):
        words = [path, path] if command == "diff" else [path]
        assert_one_line(here(command, *words), 2, path, "not a dynpf recording")


def test_files_of_other_kinds_are_refused_with_the_command_that_takes_them(tmp_path, recorded, here):
    bag, amcl = tmp_path / "a.bag", tmp_path / "amcl.yaml"
    bag.write_bytes(b"#ROSBAG V2.0\n\x8b")
    amcl.write_text("amcl:\n  alpha1: 0.2\n")
    assert_one_line(here("run", bag), 2, bag, "dynpf localize")
    assert_one_line(here("run", amcl), 2, f"dynpf import amcl {amcl}")
    assert_one_line(here("run", recorded), 2, f"dynpf replay {recorded}")
    assert_one_line(here("run", "landmark-mrclam", "--log", bag), 2, bag, "dynpf import rosbag")
    assert_one_line(
        here("run", "landmark-mrclam", "--log", tmp_path), 2, tmp_path, "it is a folder", "dynpf import rosbag"
    )


def test_an_imported_log_is_told_from_a_run(tmp_path, here):
    poses, log = tmp_path / "poses.txt", tmp_path / "log.mcap"
    poses.write_text("".join(f"{second} {second} 0 0 0 0 0 1\n" for second in range(3)))
    assert here("import", "tum", poses, "-o", log).code == 0
    for command in ("metrics", "replay"):
        assert_one_line(here(command, log), 2, log, "an imported log, no run", f"dynpf run SCENARIO --log {log}")
    assert here("info", log).code == 0


def test_a_recording_that_is_no_log_is_refused_as_one(recorded, here):
    assert_one_line(here("run", "landmark-mrclam", "--log", recorded), 2, recorded, "records of an imported log")


def test_an_output_that_cannot_be_written_is_refused(tmp_path, recorded, here, monkeypatch):
    before = recorded.read_bytes()
    assert_one_line(here(*RUN, "-o", recorded), 2, recorded, "the file exists")
    assert_one_line(here("recover", recorded, "-o", recorded), 2, recorded, "the file exists")
    assert_one_line(here("replay", recorded, "-o", recorded), 2, recorded, "the file exists")
    assert recorded.read_bytes() == before
    nowhere = tmp_path / "nowhere" / "run.mcap"
    assert_one_line(here(*RUN, "-o", nowhere), 2, nowhere, "does not exist")
    if os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        assert_one_line(
            here(*RUN, "-o", tmp_path / "locked" / "run.mcap"), 2, "run.mcap: cannot be written: Permission denied"
        )
    # A place where nobody may create a file, the superuser included.
    assert_one_line(here(*RUN, "--runner", "inline", "-o", "/proc/run.mcap"), 2, "/proc/run.mcap", "cannot be written")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("in the way")
    assert_one_line(here(*RUN, "--runner", "inline"), 2, "runs")


def test_an_unwritable_output_on_the_bus_is_told_by_the_recorder(tmp_path, dynpf):
    run = dynpf(*RUN, "-o", "/proc/run.mcap")
    assert run.wait() in (1, 2)
    assert "/proc/run.mcap: cannot be written" in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize("runner", ["bus", "inline"])
def test_a_full_disk_ends_the_run_and_keeps_what_was_written(runner, tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--runner", runner, "-o", path, most_bytes=64 * 1024)
    assert run.wait() in (1, 2)
    assert f"{path}: no room left to write" in run.stderr
    assert run.stderr.count("no room left") == 1
    assert "Traceback" not in run.stderr
    assert path.stat().st_size <= 64 * 1024
    doctor = here("doctor", path)
    assert doctor.code == 1
    assert f"dynpf recover {path} -o NEW.mcap" in doctor.out
    assert len(doctor.out.splitlines()) <= 23
    assert here("recover", path, "-o", tmp_path / "mended.mcap").code == 0


def test_a_port_in_use_is_told_by_the_router(tmp_path, dynpf):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        router = dynpf("service", "router", "landmark-room", "--listen", endpoint)
        assert router.wait() == 2
    assert endpoint in router.stderr
    assert "already in use" in router.stderr
    assert router.stderr.count("\n") == 1


def test_no_router_is_told(tmp_path, dynpf, here):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    service = dynpf("service", "estimator", "landmark-room", "--connect", endpoint)
    assert_one_line(here("health", "estimator", "--connect", endpoint, "--timeout", "0.2"), 1, endpoint, "no router")
    service.says(f"waiting for the router at {endpoint}")
    service.interrupt()
    assert service.wait() == 1
    assert "Traceback" not in service.stderr


def test_the_overview_loads_neither_numpy_nor_zenoh():
    def loaded(first):
        program = (
            f"import sys{first}; from dynpf_lab.cli.main import main; main(['--help']); "
            "print({name.partition('.')[0] for name in sys.modules} & {'numpy', 'zenoh', 'cv2', 'mcap'})"
        )
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.run(
            [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True, env=environment
        ).stdout

    overview = loaded("")
    assert overview.endswith("\nset()\n")
    assert all(re.search(rf"^  {name}\b", overview, re.MULTILINE) for name in ("run", "replay", "references"))
    assert "'zenoh'" in loaded(", zenoh"), "the check sees nothing"
