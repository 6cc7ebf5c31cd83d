"""The containers: compose runs a scenario to its end, and its recording replays exactly outside of them."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

pytestmark = [pytest.mark.container, pytest.mark.timeout(1500)]

ROOT = Path(__file__).parents[2]
DYNPF = Path(sys.executable).with_name("dynpf")
SCENARIO, SEED = "parts-3-easy", "3"
SERVICES = {"router", "simulator", "vision", "sensors", "estimator", "controller", "recorder"}


def run(
    command: Sequence[str | Path], seconds: float = 120.0, cwd: Path = ROOT, env: Mapping[str, str] | None = None
) -> str:
    """Return what the command prints; a failure shows all of it."""
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=seconds, cwd=cwd, env=env)
    output = f"{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
    assert done.returncode == 0, f"{' '.join(map(str, command))} ended with {done.returncode}:\n{output}"
    return done.stdout


@pytest.fixture(scope="module")
def base() -> str:
    """Return the name of the base image; without an engine the tests are skipped."""
    in_ci = os.environ.get("CI") == "true"
    script = [str(ROOT / ".ci/docker-engine"), *(["--install"] if in_ci else [])]
    ready = subprocess.run(script, capture_output=True, text=True, check=False)
    if ready.returncode != 0:
        reason = ready.stderr.strip().rpartition("\n")[2]
        pytest.fail(reason) if in_ci else pytest.skip(f"{reason}; as root, .ci/docker-engine --install may help")
    return ready.stdout.strip().rpartition("\n")[2]


class Compose:
    """One project of compose, with an image and a volume of its own."""

    def __init__(self, folder: Path) -> None:
        name = f"dynpf-test-{os.getpid()}"
        v2 = subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode == 0
        self._command = [*(["docker", "compose"] if v2 else ["docker-compose"]), "--project-name", name]
        self._folder = folder
        self._environment = {**os.environ, "DYNPF_IMAGE": name, "SCENARIO": SCENARIO, "SEED": SEED}
        self.image = name
        self.keys = folder / "keys"

    def __call__(self, *arguments: str, seconds: float = 120.0) -> str:
        return run([*self._command, *arguments], seconds, self._folder, self._environment)


@pytest.fixture(scope="module")
def finished(base: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Compose]:
    """Build what a checkout holds, and let its processes run until the last has ended."""
    folder = tmp_path_factory.mktemp("checkout")
    ignore = (ROOT / ".dockerignore").read_text().splitlines()
    for name in ["Dockerfile", ".dockerignore", "compose.yaml", *(line[1:] for line in ignore if line.startswith("!"))]:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, folder / name)
    if certificates := os.environ.get("PIP_CERT"):
        shutil.copy(certificates, folder / "ca-certificates.pem")
    run([DYNPF, "keys", "init", folder / "keys"])
    run([DYNPF, "keys", "issue", "--keys", folder / "keys", "--scenario", SCENARIO, "--containers"])
    compose = Compose(folder)
    compose("build", "--build-arg", f"BASE={base}", seconds=900)
    try:
        print(compose("up", "--no-color", seconds=600))
        yield compose
    finally:
        compose("down", "--volumes", "--timeout", "2")
        run(["docker", "image", "rm", compose.image])


def test_every_process_ends_well_and_unprivileged(finished: Compose) -> None:
    states = {}
    for container in finished("ps", "--all", "--quiet").split():
        form = '{{index .Config.Labels "com.docker.compose.service"}} {{.State.ExitCode}} {{.Config.User}}'
        service, code, user = run(["docker", "inspect", "--format", form, container]).split()
        states[service] = (int(code), user)
    assert states == dict.fromkeys(SERVICES, (0, "dynpf"))


def test_no_process_can_change_its_image_or_gain_privileges(finished: Compose) -> None:
    """Container by container; a process inside one finds its root read-only and has no capability."""
    form = "{{.HostConfig.ReadonlyRootfs}} {{.HostConfig.CapDrop}} {{.HostConfig.SecurityOpt}}"
    for container in finished("ps", "--all", "--quiet").split():
        assert run(["docker", "inspect", "--format", form, container]).strip() == "true [ALL] [no-new-privileges:true]"
    probe = "import pathlib; print(pathlib.Path('/proc/self/status').read_text()); pathlib.Path('/opt/dynpf/x').touch()"
    command = ["run", "--rm", "--no-deps", "-T", "--entrypoint", "python", "estimator", "-c", probe]
    with pytest.raises(AssertionError, match="Read-only file system") as caught:
        finished(*command)
    assert re.search(r"CapBnd:\s+0+\n", str(caught.value))
    assert re.search(r"NoNewPrivs:\s+1\n", str(caught.value))


STRANGER = """
import json, sys, threading, zenoh
scheme, *names = sys.argv[1:]
def opened(name):
    config = zenoh.Config()
    settings = {"mode": "client", "connect/endpoints": [scheme + "/router:7447"], "connect/timeout_ms": 3000}
    own = {"connect_certificate": name + ".pem", "connect_private_key": name + ".key"}
    if name:
        settings["transport/link/tls/enable_mtls"] = True
        files = {"root_ca_certificate": "ca.pem", **own}
        settings |= {f"transport/link/tls/{key}": f"/keys/{file}" for key, file in files.items()}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
if names == ["nobody"]:
    opened("")
heard = {name: threading.Event() for name in names}
def hear(sample):
    heard[sample.payload.to_string()].set()
with opened("simulator") as listener:
    subscriber = listener.declare_subscriber("dynpf/run/data/controller/command", hear)
    for name in names:  # the last one may, and comes after the others: what has not arrived by then does not
        with opened(name) as session:
            while True:
                session.put("dynpf/run/data/controller/command", name)
                if heard[name].wait(0.2) or name != names[-1]:
                    break
print(*[name for name in names if heard[name].is_set()])
"""


def test_a_stranger_without_a_key_is_refused_and_one_with_the_key_of_vision_commands_nothing(finished: Compose) -> None:
    finished("up", "--no-color", "--detach", "router")
    keys = ["--connect", "tls/127.0.0.1:7447", "--keys=/run/secrets"]
    finished("exec", "-T", "router", "dynpf", "health", "router", *keys, "--timeout", "60")
    network = ["docker", "run", "--rm", "--network", f"{finished.image}_default"]
    try:
        with pytest.raises(AssertionError, match="takes only processes that have a key"):
            run([*network, finished.image, "health", "router", "--connect", "tcp/router:7447", "--insecure"])
        inside = [
            "--volume",
            f"{finished.keys}:/keys:ro",
            "--user",
            "0",
            "--entrypoint",
            "python",
            finished.image,
            "-c",
        ]
        for scheme in ("tcp", "tls"):
            with pytest.raises(AssertionError, match="Unable to connect"):
                run([*network, *inside, STRANGER, scheme, "nobody"])
        assert run([*network, *inside, STRANGER, "tls", "vision", "controller"]).split() == ["controller"]
    finally:
        finished("stop", "--timeout", "2", "router")


def test_health_of_a_process_that_is_absent_is_bad(finished: Compose) -> None:
    with pytest.raises(AssertionError, match="ended with 1"):
        run(["docker", "run", "--rm", finished.image, "health", "vision"])


def test_the_recording_is_whole_and_replays_exactly_outside(finished: Compose, tmp_path: Path) -> None:
    container = finished("ps", "--all", "--quiet", "recorder").strip()
    run(["docker", "cp", f"{container}:/dynpf/runs/.", tmp_path])
    (recording,) = tmp_path.glob("*.mcap")
    run([DYNPF, "doctor", recording])
    assert json.loads(run([DYNPF, "replay", recording, "--json"], seconds=300))["same"] is True


def _container(compose: Compose, service: str) -> str:
    return compose("ps", "--all", "--quiet", service).strip()


def _recorded(container: str) -> Path:
    """Return the recording of a recorder's container, by its name in it."""
    return Path("/dynpf/runs") / f"{SCENARIO}-{SEED}-{container[:12]}.mcap"


def test_a_container_that_is_killed_goes_on_where_it_was(finished: Compose, tmp_path: Path) -> None:
    """``docker kill`` and ``docker start``; a process that is killed is started again by Docker."""
    finished("up", "--no-color", "--detach", "--force-recreate")
    recorder = _container(finished, "recorder")
    for victim, size in (("estimator", 2_000_000), ("recorder", 10_000_000), ("router", 20_000_000)):
        grown = f"until [ $(stat -c %s {_recorded(recorder)} 2>/dev/null || echo 0) -gt {size} ]; do sleep 0.05; done"
        run(["docker", "exec", recorder, "sh", "-c", grown], seconds=300)
        container = _container(finished, victim)
        if victim == "router":  # the process alone: init ends with it, and Docker starts both again
            run(["docker", "exec", container, "sh", "-c", "kill -9 $(cat /proc/1/task/1/children)"])
        else:
            run(["docker", "kill", container])
            run(["docker", "start", container])
    assert run(["docker", "wait", recorder], seconds=300).strip() == "0"
    run(["docker", "cp", f"{recorder}:/dynpf/runs/.", tmp_path])
    run([DYNPF, "doctor", tmp_path / _recorded(recorder).name])
    told = {path: json.loads(run([DYNPF, "info", path, "--json"])) for path in tmp_path.glob("*.mcap")}
    killed = told[tmp_path / _recorded(recorder).name]
    assert {"estimator", "recorder", "router"} <= {one["node"] for one in killed["restarts"]}
    (undisturbed,) = (one for one in told.values() if not one["restarts"])
    assert killed["content_digest"] == undisturbed["content_digest"]
