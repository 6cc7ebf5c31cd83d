"""The bus runner: starts one process per node, watches them, and ends all of them."""

import contextlib
import math
import multiprocessing
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from dynpf_protocol.control import Doing
from dynpf_protocol.errors import DiedAgainError, RunError
from dynpf_protocol.keys import RECORDER, ROUTER
from setproctitle import setproctitle

from dynpf_runtime.bus.guard import enlist, guard
from dynpf_runtime.bus.keys import GUESTS, run_keys
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.run_folder import GUEST_KEYS, SCENARIO_FILE, run_folder, write_place
from dynpf_runtime.bus.supervision import Asked, Finish, Kill, Restart, Say, Seen, Supervision, Terminate
from dynpf_runtime.bus.terminal import StopSignal, say

__all__ = ["Command", "Companion", "free_port", "may_fork", "reserved_port", "run_on_bus"]

Command = Callable[[Sequence[str]], int]
"""The command line: called with the arguments after ``dynpf``, returns the exit code."""

STOPS = (signal.SIGINT, signal.SIGTERM)

CLOSE_S = 1.0
"""How long the recorder may take to close its file, or a companion to leave, before it is killed."""

POLL_S = 0.02


class _Child(NamedTuple):
    """A process of the run, and its pulse."""

    process: BaseProcess
    pulse: Pulse

    def seen(self) -> Seen:
        """Return what this process sees of it now."""
        pulse = self.pulse.read()  # before the exit code: who has ended no longer hangs
        return Seen(self.process.exitcode, _is_stopped(self.process), pulse)


class Companion:
    """A process beside those of a run, which is none of them, and outlives them; it may fail.

    It calls ``command`` with the words of the command line that ``words`` makes of the run's folder, its endpoint, and
    the folder of its guests' keys.
    """

    def __init__(self, command: Command, words: Callable[[Path, str, Path | None], Sequence[str]]) -> None:
        self._command, self._words = command, words
        self._process: BaseProcess | None = None
        self.hurries = False  # a person has ended the run: nobody waits for long

    def start(self, context: BaseContext, folder: Path, endpoint: str, guests: Path | None) -> None:
        """Start it."""
        arguments = self._command, self._words(folder, endpoint, guests)
        with _signals_held(), _no_main():
            process = context.Process(  # type: ignore[attr-defined]
                target=_serve,
                args=arguments,
                name="companion",
                daemon=True,  # else an end in a hurry waits for it
            )
            process.start()
        self._process = process

    def see_off(self, patience_s: float | None) -> None:
        """Wait until it ends by itself, or end it after a time; at once if a person interrupts that."""
        if self._process is None:
            return
        until_s = math.inf if patience_s is None else time.monotonic() + patience_s
        with StopSignal.installed() as stop:  # as the run did, also where SIGINT was ignored before
            while self._process.is_alive() and not stop.requested and time.monotonic() < until_s:
                self._process.join(POLL_S)
        self._process.terminate()
        self._process.join(CLOSE_S)
        self._process.kill()  # it keeps nothing
        self._process.join()


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
    restarts: int = 0,
    durable: bool = False,
    resume: bool = False,
    further: Mapping[str, Sequence[str]] | None = None,
    companion: Companion | None = None,
) -> None:
    """Run the nodes ``names`` of a scenario, given as the text that its processes read, and record it into ``path``.

    Each process calls ``command`` with the arguments of ``dynpf service``. The processes look for user modules in the
    folders ``code``. Raises RunError that names the process that failed first; by then every process has ended.

    A process that was killed or hangs is started again, each at most ``restarts`` times. A ``durable`` recording is
    synced to disk before it is confirmed; with ``resume`` the run goes on that ``path`` is the recording of.

    A ``secure`` run has keys that live as long as it does: one for each process, and those of an observer and an
    operator in the folder ``guests``, by default one of its own. ``further`` has words for single processes by name; a
    ``companion`` is started beside them.
    """
    with run_folder() as folder, reserved_port() as port:
        resolved = folder / SCENARIO_FILE
        resolved.write_text(scenario, encoding="utf-8")
        shared = ["--quiet", "--parent", str(os.getpid())]
        for modules in code:
            shared += ["--code", str(modules.absolute())]
        endpoint = f"{'tls' if secure else 'tcp'}/127.0.0.1:{port}"
        write_place(folder, endpoint, path)
        keys: contextlib.AbstractContextManager[None] = contextlib.nullcontext()
        if secure:
            own, guests = folder / "keys", (guests or folder / GUEST_KEYS).absolute()
            shared += ["--keys", str(own)]
            keys = run_keys({own: (ROUTER, RECORDER, *names), guests: GUESTS}, datetime.now(UTC))
        services = {}
        for name in (ROUTER, RECORDER, *names):
            words = ["service", name, str(resolved), "--listen" if name == ROUTER else "--connect", endpoint, *shared]
            words += ["--pulse", str(_pulse_path(folder, name)), *([] if restarts else ["--patience", "0"])]
            if log is not None and name != ROUTER:
                words += ["--log", str(log)]
            if name == RECORDER:
                words += ["-o", str(path), *(["--durable"] if durable else []), *(["--resume"] if resume else [])]
            words += (further or {}).get(name, ())
            services[name] = words
        context = multiprocessing.get_context("fork" if may_fork() else "spawn")
        children = _Children(command, services, folder, context)
        with keys, _guarded(context, folder, guests if secure else None), children.ended(stop):
            if secure:
                say("run", f"observer and operator: --connect {endpoint} --keys {guests}")
            if companion is not None:
                companion.start(context, folder, endpoint, guests if secure else None)
            _supervise(children, stop, restarts)


def _pulse_path(folder: Path, name: str) -> Path:
    return folder / f"{name.replace('/', '.')}.pulse"


class _Children(dict[str, _Child]):
    """The processes of a run by name, each started with its words of the command line."""

    def __init__(self, command: Command, services: dict[str, list[str]], folder: Path, context: BaseContext) -> None:
        super().__init__()
        self._command, self._services, self._folder, self._context = command, services, folder, context

    def start(self, name: str) -> None:
        """Start a process, for the first time or again."""
        path = _pulse_path(self._folder, name)
        path.unlink(missing_ok=True)
        pulse = Pulse.shared(path)
        pulse.now(Doing.STARTING)
        arguments = self._command, self._services[name]
        with _signals_held(), _no_main():
            process = self._context.Process(target=_serve, args=arguments, name=name)  # type: ignore[attr-defined]
            process.start()
        enlist(process.pid, self._folder)
        self[name] = _Child(process, pulse)

    @contextlib.contextmanager
    def ended(self, stop: StopSignal) -> Iterator[None]:
        """Start all processes, and end them with the block."""
        try:
            for name in self._services:
                self.start(name)
            yield
        finally:
            _end({name: child.process for name, child in self.items()}, stopping=stop.requested)


@contextlib.contextmanager
def _guarded(context: BaseContext, folder: Path, guests: Path | None) -> Iterator[None]:
    """Have a guard for the processes of the run while the block lasts."""
    process = context.Process(target=guard, args=(os.getpid(), folder, guests), name="guard")  # type: ignore[attr-defined]
    with _signals_held(), _no_main():
        process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def may_fork() -> bool:
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
    title = " ".join(["dynpf", *words])
    setproctitle(os.fsencode(title).decode(errors="backslashreplace"))  # a file's name need not be UTF-8
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        sys.exit(command(words))
    except KeyboardInterrupt:  # it came before the command could take it; the parent tells of it
        sys.exit(1)


def _is_stopped(process: BaseProcess) -> bool:
    """Return whether a signal such as SIGSTOP has stopped a child; False where the system does not tell."""
    if process.pid is None or not hasattr(os, "waitid"):
        return False
    try:
        return os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:  # it has ended
        return False


def _end(processes: dict[str, BaseProcess], *, stopping: bool) -> None:
    """Kill all processes that still run. The recorder, which first may close its file, and the router come last.

    When the user is ``stopping`` the run the recorder is asked for the second time, and closes its file at once.
    """
    recorder = processes.get("recorder")
    if stopping and recorder is not None:
        recorder.terminate()
        recorder.join(CLOSE_S)
    for name, process in processes.items():
        if name not in {"router", "recorder"}:
            process.kill()
    if not stopping and recorder is not None:
        recorder.terminate()
        recorder.join(CLOSE_S)
    for process in processes.values():
        process.kill()  # does nothing to those that have ended
        process.join()


def _supervise(children: _Children, stop: StopSignal, restarts: int) -> None:
    """Do what the supervision of the processes asks for until all have ended; raises RunError if the run has failed."""
    supervision = Supervision(tuple(children), restarts)
    while True:
        seen = {name: child.seen() for name, child in children.items()}
        asked = Asked(stop.reason, stop.at_once) if stop.requested else Asked()
        for act in supervision.look(seen, asked, time.monotonic_ns()):
            match act:
                case Say(text):
                    say("run", text)
                case Terminate(name):
                    children[name].process.terminate()
                case Kill(name):
                    children[name].process.kill()
                case Restart(name):
                    children[name].process.join()
                    children.start(name)
                case Finish(failure, died_again):
                    if failure and died_again is not None:
                        raise DiedAgainError(failure, *died_again)
                    if failure:
                        raise RunError(failure)
                    return
        time.sleep(POLL_S)


@contextlib.contextmanager
def reserved_port() -> Iterator[int]:
    """Return a TCP port on loopback that no other run gets while the block lasts; a router may listen there."""
    with socket.socket() as held:
        # Bound and not listening, it keeps the port from those who ask for any, and not from one who may share it.
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        yield int(held.getsockname()[1])


def free_port() -> int:
    """Return a TCP port on loopback that is free now; ``reserved_port`` keeps it so."""
    with reserved_port() as port:
        return port
