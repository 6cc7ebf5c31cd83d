"""Starting dynpf's own command line in processes, waiting for what they do, and finding those that are left."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, TypeVar

from dynpf_protocol.keys import ALIVE, OBSERVER, OPERATOR, TICK
from dynpf_runtime.bus.keys import Credentials, load
from dynpf_runtime.bus.session import Bus

__all__ = ["DATA", "PATIENCE_S", "Child", "Running", "join_bus", "processes_of", "service_of", "start", "until"]

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"

PATIENCE_S = 180.0
"""How long anything may take before a test gives up; nothing is measured by it."""

_Found = TypeVar("_Found")


def until(found: Callable[[], _Found], what: str, patience_s: float = PATIENCE_S) -> _Found:
    """Return the first true value of ``found``; fails when none comes."""
    deadline = time.monotonic() + patience_s
    while not (value := found()):
        assert time.monotonic() < deadline, f"{what}: not within {patience_s:g} s"
        time.sleep(0.005)
    return value


class Child:
    """One dynpf process; stdout and stderr go to files, so that nobody can block on them."""

    def __init__(self, popen: subprocess.Popen[bytes], out: Path, err: Path) -> None:
        self.popen = popen
        self._out = out
        self._err = err

    @property
    def stdout(self) -> str:
        return self._out.read_text()

    @property
    def stderr(self) -> str:
        return self._err.read_text()

    def says(self, text: str) -> None:
        """Wait until ``text`` stands on stderr."""
        until(lambda: text in self.stderr or self.popen.poll() is not None, f"{text!r} on stderr")
        assert text in self.stderr, f"ended without saying {text!r}: {self.stderr}"

    def wait(self, patience_s: float = PATIENCE_S) -> int:
        """Return the exit code."""
        return self.popen.wait(patience_s)

    def interrupt(self) -> None:
        self.popen.send_signal(signal.SIGINT)


def start(folder: Path, *words: object, most_bytes: int | None = None, modules: Path | None = None) -> Child:
    """Start ``dynpf WORDS`` of this very source tree; all temporary files lie in ``folder``, which marks its processes.

    ``most_bytes`` limits the size of files, for it and for all that it starts; ``modules`` is a folder on their path.
    """
    number = sum(1 for _ in folder.glob("*.stderr"))
    out, err = folder / f"{number}.stdout", folder / f"{number}.stderr"
    command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", *map(str, words)]
    if most_bytes is not None:
        command = ["sh", "-c", f'ulimit -f {most_bytes // 512}; exec "$@"', "sh", *command]
    path = [ROOT] if modules is None else [ROOT, modules]
    # Not a terminal's child: a test's Ctrl-C shall reach the one process that it is sent to.
    with out.open("wb") as stdout, err.open("wb") as stderr:
        popen = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path)), "TMPDIR": str(folder)},
        )
    return Child(popen, out, err)


class Running(NamedTuple):
    """A process of this machine: its id and its command line."""

    pid: int
    words: tuple[str, ...]

    @property
    def service(self) -> str:
        """The service that it is, or ""."""
        return self.words[self.words.index("service") + 1] if "service" in self.words else ""

    @property
    def endpoint(self) -> str:
        """Where it finds the router."""
        return self.words[self.words.index("--connect") + 1]

    def credentials(self, name: str) -> Credentials | None:
        """The credentials of a guest or a process of its run, None if it runs without keys."""
        if "--keys" not in self.words:
            return None
        own = Path(self.words[self.words.index("--keys") + 1])
        return load(own.with_name("guests") if name in (OBSERVER, OPERATOR) else own, name, datetime.now(UTC))


def processes_of(folder: Path) -> list[Running]:
    """Return the living processes whose command line names something in ``folder``."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            # Processes of a run have written theirs themselves, with spaces.
            words = tuple(entry.read_bytes().decode(errors="replace").replace("\0", " ").split(" "))
        except OSError:
            continue  # it has just ended
        if any(str(folder) in word for word in words):
            found.append(Running(int(entry.parent.name), words))
    return found


def service_of(folder: Path, name: str) -> Running | None:
    """Return the process of a service, if it has been started."""
    return next((one for one in processes_of(folder) if one.service == name), None)


@contextmanager
def join_bus(endpoint: str, keys: Credentials | None = None) -> Iterator[Bus]:
    """Join a run's bus, as a stranger where that goes without keys."""
    began = time.monotonic()
    with Bus.connect(endpoint, lambda _: None, lambda: time.monotonic() - began > PATIENCE_S, keys) as bus:
        yield bus


@contextmanager
def watch_run(folder: Path, run: Child) -> Iterator["Watched"]:
    """Watch the ticks of a run that ``run`` has started, as its observer or, without keys, as a stranger."""
    node = until(lambda: service_of(folder, "estimator") or run.popen.poll() is not None, "the estimator's process")
    assert isinstance(node, Running), run.stderr
    with join_bus(node.endpoint, node.credentials(OBSERVER)) as bus:
        bus.subscribe(f"{TICK}estimator")
        yield Watched(bus, run, node.endpoint)


class Watched:
    """A run as a guest on its bus sees it."""

    def __init__(self, bus: Bus, run: Child, endpoint: str) -> None:
        self.bus = bus
        self.endpoint = endpoint
        self._run = run

    def await_ticks(self, count: int) -> None:
        """Wait for ``count`` ticks of the estimator."""
        for _ in range(count):
            until(lambda: self.bus.receive(0.1) or self._run.popen.poll() is not None, "a tick")
        assert self._run.popen.poll() is None, f"the run has ended too soon: {self._run.stderr}"

    def boot(self, node: str) -> str:
        """Return the boot that a node's liveliness token tells."""
        (token,) = self.bus.tokens(f"{ALIVE}{node}/*")
        return token.rpartition("/")[2]
