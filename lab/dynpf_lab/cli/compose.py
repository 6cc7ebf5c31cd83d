"""``dynpf compose``: a Compose file of a scenario, one container a process."""

import argparse
import shlex
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from dynpf_protocol.errors import UsageError
from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_lab.cli.options import add_scenario_options, load_log, scenario_from

__all__ = ["add_arguments", "compose_file"]

HEAD = """\
# Every process in its own container: `docker compose up --build` runs {scenario} to its end and leaves the
# recording in the volume `recordings`. SEED and DYNPF_IMAGE choose another seed and another image.
{keys}# Made by `dynpf compose {words}`, which makes one of any scenario. Kept to what docker-compose 1.29 and docker
# compose v2 both understand. Docker starts a process again that was killed, and it goes on where it was. A container
# that `docker kill` has ended it leaves alone: `docker start` goes on with it; the others wait for 30 s.
"""
HEAD_KEYS = """\
# Each process is given its own key, which is made before: `dynpf keys init {folder}` and
# `dynpf keys issue --keys {folder} --scenario {scenario} --containers`.
"""
PORT = 7447
KERNELS = "/var/cache/dynpf"
"""Where the image has its compiled kernels. Each container has a volume of its own there, which begins as that folder:
another kind of processor compiles into it, and no container can hand another one machine code."""

PROCESS: Mapping[str, Any] = {
    "image": "${DYNPF_IMAGE:-dynpf}",
    "build": ".",
    "init": True,
    "restart": "on-failure:3",
    "read_only": True,
    "tmpfs": ["/tmp"],
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
}
ROUTER_PACE: Mapping[str, Any] = {"interval": "2s", "timeout": "10s", "retries": 30}
PACE: Mapping[str, Any] = {"interval": "10s", "timeout": "10s", "start_period": "15s"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf compose``."""
    parser.description = (
        "dynpf compose SCENARIO > compose.yaml; docker compose up --build: each process of the run in its own "
        "container. Folders with files of yours are mounted read-only. With --keys, each has its own key as a secret."
    )
    add_scenario_options(parser)
    parser.add_argument(
        "--keys",
        type=Path,
        metavar="FOLDER",
        help="keys of all processes: dynpf keys issue --scenario SCENARIO --containers (default: no keys, plain tcp)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf compose`` and return its exit code."""
    from dynpf_services.scenario.build import plan_of

    log = load_log(options)
    nodes = plan_of(scenario_from(options, log)).graph.nodes
    text = compose_file(
        nodes,
        options.scenario,
        overrides=options.overrides,
        code=options.code,
        log=options.log,
        seed=options.seed,
        keys=options.keys,
    )
    print(text, end="")
    return 0


def compose_file(
    nodes: Sequence[str],
    scenario: str,
    *,
    overrides: Sequence[str] = (),
    code: Sequence[Path] = (),
    log: Path | None = None,
    seed: int | None = None,
    keys: Path | None = None,
) -> str:
    """Return the text of a Compose file that runs ``nodes`` of a scenario, beside router and recorder.

    Folders with files of the user's, such as that of the scenario, are mounted read-only. With a folder of ``keys``
    each process is given its own as a secret; without, they speak plain tcp on the network that Compose makes for them.
    """
    import yaml

    mounts: list[str] = []
    words = [_mounted(Path(scenario), "/scenario", mounts) if scenario.endswith(".toml") else scenario]
    made_by = [scenario]
    for override in overrides:
        words += ["--set", override]
        made_by += ["--set", override]
    for index, folder in enumerate(code):
        mounts.append(_mount(folder, f"/code/{index}"))
        words += ["--code", f"/code/{index}"]
        made_by += ["--code", str(folder)]
    if log is not None:
        words += ["--log", _mounted(log, "/log", mounts)]
        made_by += ["--log", str(log)]
    words = [*map(_escaped, words), "--seed", f"${{SEED:-{1 if seed is None else seed}}}"]
    if keys is not None:
        made_by += ["--keys", str(keys)]
    services = {_stem(name): _service(name, words, mounts, keys) for name in (ROUTER, *nodes, RECORDER)}
    # The name of a recorder's container stays when it is started again: so it finds what it has recorded.
    recording = f"runs/{_escaped(Path(scenario).stem)}-${{SEED:-{1 if seed is None else seed}}}-{{host}}.mcap"
    services[RECORDER]["command"] += ["-o", recording]
    made: dict[str, Any] = {"services": services}
    if keys is not None:
        made["secrets"] = {
            file: {"file": _escaped(str(keys / file) if keys.is_absolute() else f"./{keys / file}")}
            for file in dict.fromkeys(file for service in services.values() for file in service["secrets"])
        }
    text: str = yaml.safe_dump(made, sort_keys=False, default_flow_style=None, width=120)
    shown = _shown([scenario])
    secret = "" if keys is None else HEAD_KEYS.format(folder=_shown([str(keys)]), scenario=shown)
    head = HEAD.format(scenario=shown, keys=secret, words=_shown(made_by))
    return f"{head}\n{text}volumes:\n  recordings:\n"


def _shown(words: Sequence[str]) -> str:
    """Return words of a command line for a comment, which ends where its line ends."""
    return " ".join(shlex.join(words).split())


def _escaped(text: str) -> str:
    """Return a text in which Compose finds no name of a variable."""
    return text.replace("$", "$$")


def _mount(folder: Path, inside: str) -> str:
    """Return the mount of a folder, read-only; raises UsageError for a path that Compose cannot tell apart from it."""
    if ":" in str(folder.absolute()):
        raise UsageError(f"{folder}: Compose takes no folder with ':' in its path")
    return f"{_escaped(str(folder.absolute()))}:{inside}:ro"


def _mounted(file: Path, folder: str, mounts: list[str]) -> str:
    """Mount the folder of a file, and return the file's path in the container."""
    mounts.append(_mount(file.absolute().parent, folder))
    return f"{folder}/{file.name}"


def _stem(name: str) -> str:
    """Return the name of a process as Compose and files take it."""
    return name.replace("/", ".")


def _secrets(name: str) -> list[str]:
    """Return the files that a process is given as secrets."""
    files = ["ca.pem", f"{_stem(name)}.pem", f"{_stem(name)}.key"]
    return [*files, "revoked"] if name == ROUTER else files


def _service(name: str, words: Sequence[str], mounts: Sequence[str], keys: Path | None) -> dict[str, Any]:
    volumes = [KERNELS, *mounts, *(["recordings:/dynpf/runs"] if name == RECORDER else [])]
    scheme, access = ("tcp", "--insecure") if keys is None else ("tls", "--keys=/run/secrets")
    where = ["--listen", f"{scheme}/0.0.0.0:{PORT}"] if name == ROUTER else ["--connect", f"{scheme}/router:{PORT}"]
    host = "127.0.0.1" if name == ROUTER else "router"
    test = ["CMD", "dynpf", "health", name, "--connect", f"{scheme}/{host}:{PORT}", access]
    return {
        **deepcopy(PROCESS),  # YAML would refer from one service to another's list
        **({} if name == ROUTER else {"depends_on": {"router": {"condition": "service_healthy"}}}),
        "command": ["service", name, *words, *where, access],
        "volumes": volumes,
        **({} if keys is None else {"secrets": _secrets(name)}),
        "healthcheck": {"test": test, **(ROUTER_PACE if name == ROUTER else PACE)},
    }
