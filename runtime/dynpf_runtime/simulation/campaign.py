"""A campaign: many schedules of one run, each played and judged, in several processes."""

import gc
import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from typing import NamedTuple, Self

from dynpf_protocol.keys import RECORDER

from dynpf_runtime.simulation.invariants import Reference, broken
from dynpf_runtime.simulation.process import Network
from dynpf_runtime.simulation.schedule import Care, Schedule, draw
from dynpf_runtime.simulation.shrink import shrunk
from dynpf_runtime.simulation.trial import Run, Trial, play

__all__ = ["REPLAY_EVERY", "Campaign", "Verdict", "scratch"]

REPLAY_EVERY = 10
"""Of so many schedules one is replayed; every one is that breaks an invariant."""

_MEMORY = Path("/dev/shm")
_CHUNK = 8
_OBJECTS = 50_000  # new ones between two looks for garbage


class Verdict(NamedTuple):
    """What became of a schedule: whether the run is whole, its simulated time, and the invariants that it broke."""

    number: int
    whole: bool
    faults: int
    ended_ns: int
    broken: tuple[str, ...]


class Campaign:
    """The schedules of a run under a seed. ``reference`` is the undisturbed run, and ``folder`` the disk."""

    def __init__(self, run: Run, reference: Reference | None, seed: int, folder: Path) -> None:
        self._run = run
        self._reference = reference
        self._seed = seed
        self.folder = folder
        self.size = play(run, Schedule(seed, -1, (), Network(), Care.WATCHED), folder).size

    def on(self, folder: Path) -> Self:
        """Return the same campaign on another disk."""
        other = copy(self)
        other.folder = folder
        return other

    @property
    def source(self) -> str:
        """The node that leads the run."""
        return self._run.plan.graph.source

    def schedule(self, number: int, only: Sequence[int] | None = None) -> Schedule:
        """Return the schedule with a number, with ``only`` some of its faults if they are given."""
        whole = draw(self._seed, number, self.size)
        if only is None:
            return whole
        return whole._replace(faults=tuple(whole.faults[index] for index in only))

    def judge(self, schedule: Schedule, *, replay: bool) -> tuple[Verdict, Trial]:
        """Play a schedule, and say what became of it; ``replay`` the recording, too."""
        trial = play(self._run, schedule, self.folder)
        found = broken(self._run, self._reference, trial, replay=replay)
        whole = trial.simulation.ended.get(RECORDER, trial) is None
        verdict = Verdict(schedule.number, whole, len(schedule.faults), trial.simulation.now_ns, tuple(found))
        return verdict, trial

    def verdict(self, number: int) -> Verdict:
        """Return what becomes of the schedule with a number."""
        verdict, _ = self.judge(self.schedule(number), replay=number % REPLAY_EVERY == 0)
        if verdict.broken and number % REPLAY_EVERY:
            verdict, _ = self.judge(self.schedule(number), replay=True)
        return verdict

    def verdicts(self, numbers: range, jobs: int) -> Iterator[Verdict]:
        """Yield the verdicts on schedules, in no order, by as many processes."""
        if jobs == 1:
            with _rare_collections():
                yield from map(self.verdict, numbers)
            return
        context = multiprocessing.get_context("fork")
        with _rare_collections(), context.Pool(jobs, _Worker.begin, (self,)) as pool:  # the workers inherit that, too
            yield from pool.imap_unordered(_Worker.verdict, numbers, _CHUNK)

    def shrink(self, number: int) -> list[int]:
        """Return which faults of a schedule that breaks an invariant are enough to break one."""

        def fails(indices: Sequence[int]) -> bool:
            return bool(self.judge(self.schedule(number, indices), replay=True)[0].broken)

        return list(shrunk(range(len(self.schedule(number).faults)), fails))


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Have Python look for cyclic garbage rarely, and not among what is there already: a trial leaves little of it."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


class _Worker:
    """The campaign of a worker process, with a disk of the process's own."""

    campaign: Campaign

    @classmethod
    def begin(cls, campaign: Campaign) -> None:
        """Take the campaign that this process has inherited by the fork."""
        cls.campaign = campaign.on(Path(tempfile.mkdtemp(dir=campaign.folder.parent)))

    @classmethod
    def verdict(cls, number: int) -> Verdict:
        """Return what becomes of the schedule with a number."""
        return cls.campaign.verdict(number)


@contextmanager
def scratch() -> Iterator[Path]:
    """Have a folder for scratch files, in memory where the system has such a place."""
    place = _MEMORY if _MEMORY.is_dir() else None
    with tempfile.TemporaryDirectory(prefix="dynpf-", dir=place) as folder:
        yield Path(folder)
