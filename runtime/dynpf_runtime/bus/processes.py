"""The bus runner: starts one process per node, watches them, and ends all of them."""

import contextlib
import multiprocessing
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType

from dynpf_protocol.errors import BROKEN_OFF, RunError
from dynpf_protocol.keys import OBSERVER, OPERATOR, RECORDER, ROUTER
from setproctitle import setproctitle

from dynpf_runtime.bus.keys import run_keys
from dynpf_runtime.bus.terminal import StopSignal, say

__all__ = ["Command", "free_port", "run_on_bus"]

Command = Callable[[Sequence[str]], int]
"""The command line: called with the arguments after ``dynpf``, returns the exit code."""

STOPS = (signal.SIGINT, signal.SIGTERM)

GRACE_S = 2.5
"""How long the other processes may take to stop by themselves after one has failed."""

HANG_S = 5.0
"""How long no process may end, after some have ended because of another, before the remaining ones count as hanging.

On a busy machine processes notice at very different times that their run has broken off.
"""

CLOSE_S = 1.0
"""How long the recorder may take to close its file when all others have been killed."""

POLL_S = 0.02


def run_on_bus(
    command: Command,
    names: Sequence[str],
    scenario: str,
    path: Path,
    *,
    stop: StopSignal,
    log: Path | None = None,
    code: Sequence[Path] = (),
    secure: bool = True,
    guests: Path | None = None,
) -> None:
    """Run the nodes ``names`` of a scenario, given as the text that its processes read, and record it into ``path``.

    Each process calls ``command`` with the arguments of ``dynpf service``. The processes look for user modules in the
    folders ``code``. Raises RunError that names the process that failed first; by then every process has ended.

    A ``secure`` run has keys that live as long as it does: one for each process, and those of an observer and an
    operator in the folder ``guests``, by default one of its own.
    """
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        resolved = Path(folder) / "scenario.json"
        resolved.write_text(scenario, encoding="utf-8")
        shared = ["--quiet", "--parent", str(os.getpid())]
        for modules in code:
            shared += ["--code", str(modules.absolute())]
        endpoint = f"{'tls' if secure else 'tcp'}/127.0.0.1:{free_port()}"
        keys: contextlib.AbstractContextManager[None] = contextlib.nullcontext()
        if secure:
            own, guests = Path(folder) / "keys", (guests or Path(folder) / "guests").absolute()
            shared += ["--keys", str(own)]
            keys = run_keys({own: (ROUTER, RECORDER, *names), guests: (OBSERVER, OPERATOR)}, datetime.now(UTC))
        services = {}
        for name in (ROUTER, RECORDER, *names):
            words = ["service", name, str(resolved), "--listen" if name == ROUTER else "--connect", endpoint, *shared]
            if log is not None and name != ROUTER:
                words += ["--log", str(log)]
            if name == RECORDER:
                words += ["-o", str(path)]
            services[name] = words
        with keys, _processes(command, services) as processes:
            if secure:
                say("run", f"observer and operator: --connect {endpoint} --keys {guests}")
            _watch(processes, stop)


@contextlib.contextmanager
def _processes(command: Command, services: dict[str, list[str]]) -> Iterator[dict[str, BaseProcess]]:
    context = multiprocessing.get_context("fork" if _may_fork() else "spawn")
    processes: dict[str, BaseProcess] = {}
    try:
        with _signals_held(), _no_main():
            for name, words in services.items():
                process = context.Process(target=_serve, args=(command, words), name=name)  # type: ignore[attr-defined]
                process.start()
                processes[name] = process
        yield processes
    finally:
        _end(processes)


def _may_fork() -> bool:
    """Return whether this process can be forked: on Linux, unless something, say a user module, has started threads.

    A fork has all modules loaded, which takes a new process about a second.
    """
    tasks = Path("/proc/self/task")
    return sys.platform == "linux" and len(list(tasks.iterdir())) == 1


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Block the stop signals, so that a new process does not lose one before it sets its own handlers."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _no_main() -> Iterator[None]:
    """Hide the module that this process was started with, which a new process would else execute once more.

    It may be a script of the user's that calls us.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _serve(command: Command, words: Sequence[str]) -> None:
    """Run a process of the run; does not return."""
    os.setsid()  # its own session: Ctrl-C reaches only the parent, which asks the run to end cleanly
    setproctitle(" ".join(["dynpf", *words]))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        sys.exit(command(words))
    except KeyboardInterrupt:  # it came before the command could take it; the parent tells of it
        sys.exit(1)


def _end(processes: dict[str, BaseProcess]) -> None:
    """Kill all processes that still run. The recorder, which first may close its file, and the router come last."""
    for name, process in processes.items():
        if name not in {"router", "recorder"}:
            process.kill()
    if "recorder" in processes:
        processes["recorder"].terminate()
        processes["recorder"].join(CLOSE_S)
    for process in processes.values():
        process.kill()  # does nothing to those that have ended
        process.join()


def _watch(processes: dict[str, BaseProcess], stop: StopSignal) -> None:
    failed = ""
    deadline: float | None = None
    stopping = False
    left = len(processes)
    while running := [name for name, process in processes.items() if process.exitcode is None]:
        if not stop.requested:
            before, failed = failed, failed or _failure(processes)
            if failed and not before:
                deadline = time.monotonic() + GRACE_S
            elif not failed and len(running) < left and any(process.exitcode for process in processes.values()):
                deadline = time.monotonic() + HANG_S
            left = len(running)
        if stop.requested and not stopping:
            stopping = True
            say("run", f"{stop.reason}: ending the run (again to end it at once)")
            for name in running:
                processes[name].terminate()
            deadline = deadline or time.monotonic() + 10.0
        if (deadline is not None or stop.requested) and running == ["router"]:
            processes["router"].terminate()  # it waits for a run that will not begin
        if stop.at_once or (deadline is not None and time.monotonic() > deadline):
            names = ", ".join(running)
            raise RunError(f"{failed or stop.reason or f'{names} hangs'}; killed what was left: {names}")
        time.sleep(POLL_S)
    if stop.requested:
        if processes["recorder"].exitcode != 0:
            raise RunError(f"{stop.reason} before the run had begun")
        return
    failed = failed or _failure(processes)
    if failed:
        raise RunError(failed)
    if broken := [name for name, process in processes.items() if process.exitcode]:
        raise RunError(f"{', '.join(broken)} broke off")


def _failure(processes: dict[str, BaseProcess]) -> str:
    """Return a sentence on the process that failed first, empty while processes have ended only because of others.

    A killed process is the cause, whatever the exit codes of the others.
    """
    codes = {name: process.exitcode or 0 for name, process in processes.items()}
    for name, code in codes.items():
        if code < 0:
            return f"{name} was killed by signal {-code}"
    for name, code in codes.items():
        if code not in (0, BROKEN_OFF):
            return f"{name} ended with exit code {code}"
    return ""


def free_port() -> int:
    """Return a free TCP port on loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
