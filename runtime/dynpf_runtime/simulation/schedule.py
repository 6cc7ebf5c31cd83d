"""Schedules: which faults befall a run, drawn from a seed.

Each schedule first draws which kinds of faults it has at all, and how many of each: what only some kinds together bring
about is met sooner than if each schedule had a little of everything (Groce et al., Swarm Testing, ISSTA 2012).
"""

from collections.abc import Callable, Mapping
from enum import Enum
from random import Random
from typing import NamedTuple

from dynpf_protocol.keys import RECORDER, ROUTER

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
from dynpf_runtime.simulation.process import Network

__all__ = ["KINDS", "Care", "Schedule", "Size", "draw"]

MS = 1_000_000
SECOND = 1_000_000_000

_SHARE = 0.25
"""The probability that a schedule has a kind of faults."""


class Size(NamedTuple):
    """How much there is in an undisturbed run that faults can strike."""

    events: Mapping[str, int]  # of each process
    messages: Mapping[str, int]  # to each process
    writes: int
    bytes: int


class Care(Enum):
    """Who looks after the processes of a run."""

    ALONE = "nobody watches"
    WATCHED = "dynpf run watches, and starts nobody again"
    KEPT = "who is killed or hangs is started again"


class Schedule(NamedTuple):
    """The faults of one simulated run, the seed and the size of its network, and who looks after its processes.

    At every so many digests of a node's state a snapshot is taken; with 0 as the budget of longer runs allows.
    """

    seed: int
    number: int
    faults: tuple[Fault, ...]
    network: Network
    care: Care
    snapshot_digests: int = 0

    @property
    def network_seed(self) -> int:
        """The seed of everything random in the network."""
        return Random(f"{self.seed} {self.number} network").getrandbits(64)

    def __str__(self) -> str:
        network = ", ".join(f"{name} {value / MS:g} ms" for name, value in self.network._asdict().items())
        head = f"schedule {self.number} of seed {self.seed}: {self.care.value}; at most {network.replace('_ns', '')}"
        if self.snapshot_digests:
            head += f"; a snapshot of a node at every {self.snapshot_digests} digests of a state"
        return "\n".join([head, *(f"  {index}  {text_of(fault)}" for index, fault in enumerate(self.faults))])


class _Draw:
    """Draws the numbers of faults."""

    def __init__(self, random: Random, size: Size, *, gentle: bool) -> None:
        self.random = random
        self.size = size
        self.gentle = gentle

    def process(self, *, router: bool = True) -> str:
        """Return any process; the recorder and the router as often as all nodes together."""
        names = [name for name in self.size.events if name not in (RECORDER, ROUTER)]
        return self.random.choice([self.random.choice(names), RECORDER, *([ROUTER] if router else [])])

    def event(self, *, router: bool = True) -> tuple[str, int]:
        """Return a process and one of its events."""
        name = self.process(router=router)
        return name, self.random.randrange(self.size.events[name] * 5 // 4)  # some strike only who was started again

    def message(self) -> tuple[str, int]:
        """Return a process and one of the messages to it."""
        name = self.process(router=False)
        return name, self.random.randrange(self.size.messages[name])

    def ns(self, shortest: int, longest: int) -> int:
        """Return a duration, a short one as likely as a long one."""
        return int(shortest * (longest / shortest) ** self.random.random())

    def pause(self, longest: int, at_worst: int) -> int:
        """Return how long something pauses: up to ``longest`` in gentle schedules, else longer, or 0 for ever."""
        if not self.gentle and self.random.random() < 0.25:
            return 0
        return self.ns(1 * MS, longest if self.gentle else at_worst)


def _crash(draw: _Draw) -> Fault:
    effects = draw.random.choice((0, 0, 1, 2, 3, 5, 8))
    return Crash(*draw.event(), effects, draw.random.choice((0, 0, 1, 3, 8)))


def _freeze(draw: _Draw) -> Fault:
    return Freeze(*draw.event(), draw.pause(800 * MS, 10 * SECOND))


def _hang(draw: _Draw) -> Fault:
    return Hang(*draw.event(), draw.pause(2 * SECOND, 30 * SECOND))


def _cut(draw: _Draw) -> Fault:
    return Cut(*draw.event(router=False), draw.ns(1 * MS, SECOND if draw.gentle else 20 * SECOND))


def _slow(draw: _Draw) -> Fault:
    return Slow(*draw.event(), draw.random.randint(1, 50), draw.ns(MS // 10, 20 * MS))


def _clock(draw: _Draw) -> Fault:
    return Clock(*draw.event(), draw.random.choice((-1, 1)) * draw.ns(1 * MS, 3 * 10**8 * SECOND))


def _delay(draw: _Draw) -> Fault:
    return Delay(*draw.message(), draw.ns(MS // 10, 800 * MS))


def _reorder(draw: _Draw) -> Fault:
    return Reorder(*draw.message(), draw.ns(MS // 10, 300 * MS))


def _duplicate(draw: _Draw) -> Fault:
    return Duplicate(*draw.message(), draw.ns(MS // 100, 300 * MS))


def _drop(draw: _Draw) -> Fault:
    return Drop(*draw.message())


def _full_disk(draw: _Draw) -> Fault:
    return FullDisk(draw.random.randrange(draw.size.bytes))


def _tear(draw: _Draw) -> Fault:
    return Tear(draw.random.randrange(draw.size.writes), draw.random.randrange(256))


def _power_loss(draw: _Draw) -> Fault:
    return PowerLoss(*draw.event(), draw.random.getrandbits(32))


_MANY, _SOME, _ONE = 6, 3, 1

KINDS: Mapping[str, tuple[Callable[[_Draw], Fault], int]] = {
    "delay": (_delay, _MANY),
    "reorder": (_reorder, _MANY),
    "duplicate": (_duplicate, _MANY),
    "slow": (_slow, _SOME),
    "clock": (_clock, _SOME),
    "freeze": (_freeze, _SOME),
    "hang": (_hang, _SOME),
    "cut": (_cut, _SOME),
    "crash": (_crash, _SOME),
    "drop": (_drop, _ONE),
    "full-disk": (_full_disk, _ONE),
    "tear": (_tear, _ONE),
    "power-loss": (_power_loss, _ONE),
}
"""How a fault of each kind is drawn, and how many of them a schedule may have."""

_HARSH = frozenset({"crash", "drop", "full-disk", "tear", "power-loss"})
"""What gentle schedules have none of: then the run has to be whole."""


_SNAPSHOT_DIGESTS = (0, 0, 1, 2)

_CARES = (Care.ALONE, Care.WATCHED, Care.KEPT, Care.KEPT)


def draw(seed: int, number: int, size: Size) -> Schedule:
    """Return the schedule with a number under a seed, for a run of this size. Every second one is gentle."""
    random = Random(f"{seed} {number}")
    gentle = random.random() < 0.5
    drawing = _Draw(random, size, gentle=gentle)
    faults: list[Fault] = []
    for kind, (one, most) in KINDS.items():
        if random.random() < _SHARE and not (gentle and kind in _HARSH):
            faults += [one(drawing) for _ in range(random.randint(1, most))]
    network = Network(
        delay_ns=drawing.ns(MS // 100, 10 * MS),
        work_ns=drawing.ns(MS // 1000, 1 * MS),
        start_ns=drawing.ns(MS, 300 * MS),
        answer_ns=drawing.ns(MS // 100, 300 * MS),
    )
    care, digests = random.choice(_CARES), random.choice(_SNAPSHOT_DIGESTS)
    return Schedule(seed, number, tuple(faults), network, care, digests)
