"""The planted runs: how each is recorded, what its failure is, and what ``dynpf why`` has to find."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from dynpf_experiments.drive import drive
from dynpf_experiments.why.asking import Answer
from dynpf_experiments.why.causes import Event, Stretch
from dynpf_experiments.why.condition import parse
from dynpf_experiments.why.futures import Future, Trunk
from dynpf_experiments.why.quantities import quantities_of
from dynpf_experiments.why.search import LEVEL
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.recording.attachments import LANDMARKS
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.messages import Odometry
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.replay import scenario_of_replay
from dynpf_services.scenario.user_code import add_folders
from msgspec.structs import replace

from dynpf.rng import generator

__all__ = ["CASES", "Case", "names_chance", "names_event", "names_stretch"]

RUNS = Path(__file__).with_name("runs")

DAMAGED_NS = 8_000_000_000, 8_300_000_000
"""From when to before when the log's odometry is damaged."""

_DENSE = 30
"""Ticks before a collision, and futures from each, that are looked at."""

_LOGGED = {"truth/robot": "log/truth", "sensors/odometry": "log/odometry", "sensors/landmarks": "log/landmarks"}


class Case(NamedTuple):
    """A planted run.

    ``record`` writes it into a folder. ``planted`` returns the first and the last tick of what was planted in it;
    ``named`` says whether an answer names it.
    """

    record: Callable[[Path], Recording]
    when: str
    planted: Callable[[Recording], tuple[int, int]]
    named: Callable[[Answer], bool]
    allow_code: tuple[str, ...] = ()


def names_event(answer: Answer) -> bool:
    """Return whether an event alone is named, and chance is not."""
    causes = [named.cause for named in answer.reasons.causes]
    return answer.reasons.chance is None and len(causes) == 1 and isinstance(causes[0], Event)


def names_stretch(answer: Answer) -> bool:
    """Return whether a stretch of odometry is named first, and chance is not."""
    causes = [named.cause for named in answer.reasons.causes[:1]]
    return answer.reasons.chance is None and [cause.way.topic for cause in causes if isinstance(cause, Stretch)] == [
        "log/odometry"
    ]


def names_chance(answer: Answer) -> bool:
    """Return whether chance is named."""
    return answer.reasons.chance is not None


def _scenario_run(name: str) -> Callable[[Path], Recording]:
    def record(folder: Path) -> Recording:
        """Record the scenario of that name."""
        add_folders([RUNS])
        path = folder / f"{name}.mcap"
        record_inline(load_scenario(str(RUNS / f"{name}.toml")), path)
        return read_recording(path)

    return record


def _logged(folder: Path) -> Recording:
    """Drive, write down what the robot sensed, damage the odometry, and let a filter run on that log."""
    scenario = load_scenario(str(RUNS / "driven.toml"))
    run = drive(scenario, list(_LOGGED))
    timed = [(each, log) for topic, log in _LOGGED.items() for each in run.topic(topic)]
    records = [
        Record(log, each.stamp_ns, _damaged(each.message, each.stamp_ns) if log == "log/odometry" else each.message)
        for each, log in sorted(timed, key=lambda pair: pair[0].number)
    ]
    marks = (
        b"[" + b",".join(b'{"id":%d,"x":%f,"y":%f}' % (mark.id, mark.x, mark.y) for mark in scenario.landmarks) + b"]"
    )
    attachment = Attachment(name=LANDMARKS, media_type="application/json", data=marks)
    write_recording(ImportedLog("driven.toml", "simulated", {}, records, Losses(), (attachment,)), folder / "log.mcap")
    log = PlayedLog(folder / "log.mcap")
    path = folder / "logged.mcap"
    record_inline(load_scenario(str(RUNS / "logged.toml"), log=log.facts), path, log)
    return read_recording(path)


def _damaged(message: object, stamp_ns: int) -> Odometry:
    """Return a record of odometry, with a speed that the robot never had while it is damaged."""
    assert isinstance(message, Odometry)
    return replace(message, v=4.0) if DAMAGED_NS[0] <= stamp_ns < DAMAGED_NS[1] else message


def _damaged_ticks(recording: Recording) -> tuple[int, int]:
    ticks = [
        tick
        for record in recording.messages("log/odometry")
        if DAMAGED_NS[0] <= record.stamp_ns < DAMAGED_NS[1] and (tick := recording.tick_of(record)) is not None
    ]
    return min(ticks), max(ticks)


def _last_avertable(recording: Recording) -> tuple[int, int]:
    """Return the last tick before the collision from which enough futures do without it, by many futures from each."""
    when = "truth/parts.contacts > 0"
    scenario = scenario_of_replay(recording, allow_code=["planted"])
    trunk = Trunk(recording, scenario, parse(when), quantities_of(parse(when), when, plan_of(scenario)), within=100)
    draws = generator(0, "oracle", 0)
    failed = trunk.failure.tick
    for tick in range(failed, failed - _DENSE, -1):
        fates = [trunk.fails(Future(tick, seed=draws.integers(2**62))) for _ in range(_DENSE)]
        if sum(fates) < LEVEL * len(fates):
            return tick, tick
    raise ValueError(f"no future from tick {failed - _DENSE + 1} on does without the collision")


CASES: Mapping[str, Case] = {
    "kidnapped": Case(
        _scenario_run("kidnapped"), "position_error > 0.5 and time > 13", lambda _: (120, 120), names_event
    ),
    "damaged log": Case(_logged, "position_error > 0.5 and time > 9", _damaged_ticks, names_stretch),
    "burst of noise": Case(
        _scenario_run("burst"), "position_error > 0.45 and time > 11", lambda _: (100, 102), names_chance, ("planted",)
    ),
    "collision": Case(
        _scenario_run("collision"), "truth/parts.contacts > 0", _last_avertable, names_chance, ("planted",)
    ),
}
