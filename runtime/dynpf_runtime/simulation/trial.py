"""A trial: one run of a plan, simulated from beginning to end under a schedule of faults."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, Self

from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_runtime.machines.effects import NEVER_NS, Effect
from dynpf_runtime.machines.events import Event
from dynpf_runtime.machines.node_host import NodeHost
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation.disk import Disk
from dynpf_runtime.simulation.faults import (
    Clock,
    Crash,
    Cut,
    Delay,
    Drop,
    Duplicate,
    Fault,
    Freeze,
    FullDisk,
    Hang,
    PowerLoss,
    Reorder,
    Slow,
    Tear,
    text_of,
)
from dynpf_runtime.simulation.network import Simulation
from dynpf_runtime.simulation.schedule import Care, Schedule, Size
from dynpf_runtime.simulation.watch import Watch
from dynpf_runtime.source import LogRecord

__all__ = ["ENDPOINT", "FILE", "LIMIT_NS", "STANDSTILL_NS", "Run", "Trial", "play", "resume"]

ENDPOINT = "tls/simulated:1"

FILE = "run.mcap"
"""What the recording is called."""

PATIENCE_NS = 30_000_000_000
"""How long processes wait for one that is gone, if somebody starts it again."""

RESTARTS = 3
"""How often a process is started again, if any is."""

STANDSTILL_NS = 60_000_000_000
"""After so long the user asks a run to end that stands still."""

AGAIN_NS = 90_000_000_000
"""After so long the user asks again, which is to end everything at once."""

LIMIT_NS = 120_000_000_000
"""After so long a run hangs: no process may wait for longer for anything."""


class Recording(Protocol):
    """Carries out a recorder's effects on its file; a context that its process leaves when it ends by itself."""

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None: ...

    def perform(self, effect: Effect) -> Event | None:
        """Carry out an effect."""


OpenRecording = Callable[[Plan, str, Path, Callable[..., RecordingWriter]], Recording]
"""Returns the recording of a recorder with its boot, which makes its writer by the last argument."""


class Run(NamedTuple):
    """What is simulated: the plan, the log that it plays, what makes a recorder's file, and what reads its boots.

    A ``durable`` file is one that the recorder syncs before it confirms.
    """

    plan: Plan
    log: Sequence[LogRecord]
    open_recording: OpenRecording
    recorded_boots: Callable[[Path, Plan], Mapping[str, str]]
    durable: bool = False


class Trial(NamedTuple):
    """A run that was simulated. ``hung`` says that it did not end; ``failure`` is what ``dynpf run`` said of it.

    ``asked`` says that the user had to end it, ``exhausted`` that a process was killed more often than it may be
    started again, ``waited`` who neither hung nor was cut off when ``dynpf run`` had to kill it in the end.
    """

    schedule: Schedule
    simulation: Simulation
    disk: Disk
    hung: bool
    asked: bool
    exhausted: bool
    failure: str | None
    waited: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Where the recording is, if one was begun."""
        return self.disk.folder / FILE

    @property
    def size(self) -> Size:
        """How much there was that faults could have struck."""
        processes = self.simulation.processes
        return Size(
            {name: process.events for name, process in processes.items()},
            {name: max(1, process.arrivals) for name, process in processes.items()},
            self.disk.writes,
            self.disk.used,
        )


class _Gauges:
    """What a simulated process measures of itself: the step that it is in, and no time."""

    def __init__(self, name: str, ticks: dict[str, int]) -> None:
        self._name = name
        self._ticks = ticks

    def stepping(self, tick: int) -> None:
        """Note that a step of the node begins."""
        self._ticks[self._name] = tick

    def stopwatch_s(self) -> float:
        """Return no time."""
        return 0.0

    def waiting(self) -> int:
        """Return that nothing waits."""
        return 0


def play(run: Run, schedule: Schedule, folder: Path) -> Trial:
    """Simulate a run under a schedule until all of its processes have ended; its disk is ``folder``."""
    disk = Disk(folder)
    try:
        return _play(run, schedule, disk)
    finally:
        disk.close()


def resume(run: Run, trial: Trial) -> Trial:
    """Simulate that the run of a trial, all of whose processes are gone, is resumed from its recording.

    Raises RecordingError if that cannot be read.
    """
    boots = run.recorded_boots(trial.path, run.plan)
    disk = Disk(trial.disk.folder, kept=True)
    try:
        return _play(run, trial.schedule._replace(faults=(), care=Care.KEPT), disk, boots)
    finally:
        disk.close()


def _play(run: Run, schedule: Schedule, disk: Disk, resumes: Mapping[str, str] | None = None) -> Trial:
    run = run._replace(plan=run.plan._replace(snapshot_digests=schedule.snapshot_digests))
    simulation = Simulation(schedule.network_seed, ROUTER, schedule.network)
    cast = _Cast(run, simulation, disk, PATIENCE_NS if schedule.care is Care.KEPT else 0, resumes)
    for name in (ROUTER, RECORDER, *run.plan.graph.nodes):
        cast.start(name)
    for fault in schedule.faults:
        _prepare(fault, simulation, disk)
    watch = None
    if schedule.care is not Care.ALONE:
        watch = Watch(simulation, cast.ticks, RESTARTS if schedule.care is Care.KEPT else 0, cast.start)
    asked = not _ends_within(STANDSTILL_NS, simulation)
    hung = asked
    for at_once, limit_ns in ((False, AGAIN_NS), (True, LIMIT_NS)):
        if hung:
            _interrupt(simulation, watch, at_once=at_once)
            hung = not _ends_within(limit_ns, simulation)
    exhausted, failure = (False, None) if watch is None else (watch.exhausted, watch.failure)
    waited = () if watch is None else tuple(watch.waited)
    return Trial(schedule, simulation, disk, hung, asked, exhausted, failure, waited)


class _Cast:
    """Starts the processes of a run, for the first time and again."""

    def __init__(
        self, run: Run, simulation: Simulation, disk: Disk, patience_ns: int, resumes: Mapping[str, str] | None = None
    ) -> None:
        self.ticks: dict[str, int] = {}
        self._run = run
        self._simulation = simulation
        self._disk = disk
        self._patience_ns = patience_ns
        self._resumes = resumes  # the last start of each process, if the run is resumed
        self._starts: Counter[str] = Counter()

    def start(self, name: str) -> None:
        """Start a process, under a name of its own for this start."""
        self._starts[name] += 1
        start = f"{name}-{'' if self._resumes is None else 'r'}{self._starts[name]}"
        begin = self._simulation.add if self._starts[name] == 1 else self._simulation.restart
        plan, patience_ns = self._run.plan, self._patience_ns
        if name == ROUTER:
            begin(name, RouterMachine(plan, start))
        elif name == RECORDER:
            path = self._disk.folder / FILE
            recording = self._run.open_recording(plan, start, path, partial(RecordingWriter, open_file=self._disk.open))
            exists, resumes = path.exists(), self._resumes
            machine = RecorderMachine(
                plan, start, ENDPOINT, FILE, patience_ns=patience_ns, exists=exists, resumes=resumes
            )
            begin(name, machine, recording.perform, partial(_leave, recording))
        else:
            node, gauges = plan.graph.specs[name].build(), _Gauges(name, self.ticks)
            log = self._run.log
            host = NodeHost(name, node, plan, start, endpoint=ENDPOINT, log=log, gauges=gauges, patience_ns=patience_ns)
            begin(name, host)


def _ends_within(limit_ns: int, simulation: Simulation) -> bool:
    """Simulate on, and return whether all processes have ended by this time."""
    try:
        simulation.run(limit_ns=limit_ns)
    except TimeoutError:
        return False
    return True


def _interrupt(simulation: Simulation, watch: Watch | None, *, at_once: bool) -> None:
    """Act like a user who wants a run to end that stands still."""
    simulation.tell("user", "asks again" if at_once else "asks the run to end")
    if watch is not None:
        watch.interrupt(at_once=at_once)
        return
    for name in simulation.processes:
        simulation.ask_to_stop(name, "stopped by the user", at_once=at_once)


def _leave(recording: Recording, error: BaseException | None) -> None:
    recording.__exit__(None if error is None else type(error), error, None)


def _prepare(fault: Fault, simulation: Simulation, disk: Disk) -> None:
    """Have a fault strike when its moment comes."""
    match fault:
        case FullDisk(room):
            disk.room = room
        case Tear(write, kept):
            disk.tears[write] = kept
        case Drop(process, message):
            simulation.deliver(process, message)
        case Duplicate(process, message, by_ns):
            simulation.deliver(process, message, (0, 0), (0, by_ns))
        case Delay(process, message, by_ns):
            simulation.deliver(process, message, (by_ns, 0))
        case Reorder(process, message, by_ns):
            simulation.deliver(process, message, (0, by_ns))
        case _:
            simulation.befall(fault.process, fault.event, partial(_strike, fault, simulation, disk))


def _strike(fault: Fault, simulation: Simulation, disk: Disk) -> None:
    simulation.tell("fault", text_of(fault))
    match fault:
        case Crash(process, _, effects, unsent):
            simulation.kill(process, effects, unsent)
        case Freeze(process, _, for_ns):
            simulation.freeze(process, for_ns or NEVER_NS)
        case Hang(process, _, for_ns):
            simulation.hang(process, for_ns or NEVER_NS)
        case Cut(process, _, for_ns):
            simulation.cut(process, for_ns)
        case Slow(process, _, events, each_ns):
            simulation.slow(process, events, each_ns)
        case Clock(_, _, by_ns):
            simulation.wall_ns += by_ns
        case PowerLoss(_, _, draw):
            disk.lose_power(draw)
            for name in simulation.processes:
                simulation.kill(name)
