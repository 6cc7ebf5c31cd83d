"""How well robots are localized on real floors: logs with a reference, and the same logs made harder.

Usage: DYNPF_DATA=FOLDER python benchmarks/floors.py [accuracy] [stress] [kidnap] [landmarks] [--seeds N] [--first N]
       [--only WORD] [--set KEY=VALUE]...

Each part prints a table: means over seeds, with the upper end of their 95 % interval in brackets. The settings are
the same for all logs; ``--only`` takes the rows whose names begin with a word. The estimator runs by itself, from
record to record, as it does in a run. NEES is the mean over blocks of ten seconds, beside its band for their number. A
teleport is a scan over which the estimate moves, as seen from where it was, by a metre more or less than the robot
does; wrong is 1 m or 20 degrees off.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.data import data_path
from dynpf_protocol.messages import Estimate
from dynpf_runtime.node import Received, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import LogFacts
from dynpf_systems.rooms.localization.estimator import LocalizationEstimator
from dynpf_systems.rooms.maps import Maps
from dynpf_systems.rooms.measures import FOUND_M, FOUND_RAD
from dynpf_systems.rooms.studies.landmark_logs import follow, opened, stretches
from dynpf_systems.rooms.studies.laser_logs import LaserLog, Record, log_named
from dynpf_systems.rooms.studies.laser_runs import UpdateCount, kidnapped
from dynpf_systems.rooms.studies.logs import sources
from floor_stress import STRESSES, Trial, alcoves, grid_of

from dynpf.metrics.consistency import mean_square, nees
from dynpf.metrics.seeds import mean
from dynpf.metrics.trajectory import score
from dynpf.se2 import relative, wrap_angle

LOGS = ("intel", "intel-split", "freiburg-split", "jarvis", "simpath2")
STRESSED = ("intel", "freiburg", "jarvis", "simpath2")
STRETCH, LEAD, WITHIN, FAR_M = 250, 30, 20, 5.0
WRONG_M, WRONG_RAD, TELEPORT_M = 1.0, math.radians(20.0), 1.0
ALARMS = ("lost", "kidnapped", "map_does_not_fit")


_ANY_MAP = {  # a scenario has to have one; the trial brings its own
    "map.yaml": b"image: map.pgm\nresolution: 1.0\norigin: [0.0, 0.0, 0.0]\n"
    b"negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
    "map.pgm": b"P5\n1 1\n255\n\x00",
}


class Course(NamedTuple):
    """The estimates after scans: stamps (T,), s, poses and true ones (3, T), covariances, verdicts, updates so far."""

    stamps: np.ndarray
    poses: np.ndarray
    true: np.ndarray
    covariances: np.ndarray
    verdicts: list[str]
    updates: list[int]

    @property
    def errors(self) -> np.ndarray:
        """Position (m) and heading (rad), (2, T)."""
        away = self.poses - self.true
        return np.array([np.hypot(away[0], away[1]), np.abs(wrap_angle(away[2]))])


def course_of(
    trial: Trial, seed: int, overrides: Sequence[str], enough: Callable[[int], bool] = lambda _: False
) -> Course:
    """Run the scenario's estimator on the records."""
    scenario = load_scenario("laser-log", overrides=overrides, seed=seed, log=LogFacts("", [], {}, _ANY_MAP))
    config: Any = scenario.estimator
    estimator = LocalizationEstimator(config=config, seed=seed, maps=Maps(grid=trial.grid), classes={})
    count, announced, number, rows = UpdateCount(config), None, 0, []
    for record in trial.records:
        messages = [(record.topic.replace("log/", "sensors/"), record.message)]
        if record.scanner is not None and record.scanner != announced:
            announced = record.scanner
            messages.insert(0, ("sensors/scanner", announced))
        for topic, message in messages:
            count.see(message)
            received = Received(topic, "sensors", "", number, record.stamp_ns, message)
            outputs = estimator.step(Step(number, number, record.stamp_ns, (received,))).outputs
            number += 1
        state = next((output.message for output in outputs if isinstance(output.message, Estimate)), None)
        if record.truth is not None and state is not None:
            verdict = state.health.status if state.health else ""
            pose = (state.x, state.y, state.theta)
            rows.append((record.stamp_ns * 1e-9, pose, record.truth, state.covariance, verdict, count.updates))
            if enough(len(rows)):
                break
    stamps, poses, true, covariances, verdicts, updates = zip(*rows, strict=True)
    return Course(
        np.array(stamps),
        np.array(poses).T,
        np.array(true).T,
        np.array(covariances).reshape(-1, 3, 3),
        list(verdicts),
        list(updates),
    )


def known_start(record: Record) -> str:
    """Return the override for a start where the robot was at a scan."""
    assert record.truth is not None
    x, y, theta = record.truth
    return f'estimator.start={{kind="known",x={x!r},y={y!r},theta={theta!r},sigma_position=0.2,sigma_heading=0.1}}'


def block_nees(course: Course, length: float = 10.0) -> tuple[float, float, float]:
    """Return the mean over blocks of their mean NEES, and the band of that for an honest filter."""
    away = course.poses - course.true
    away[2] = wrap_angle(away[2])
    values = nees(away, course.covariances)
    blocks = np.floor((course.stamps - course.stamps.min()) / length)
    means = np.array([np.nanmean(values[blocks == block]) for block in np.unique(blocks)])
    found = mean_square(means, 3)
    return found.figure, found.low, found.high


def figures(course: Course) -> dict[str, float]:
    """Return the measures of a course."""
    position, heading = course.errors
    wrong = (position > WRONG_M) | (heading > WRONG_RAD)
    tracking = np.array([verdict == "tracking" for verdict in course.verdicts])
    estimated, made = (relative(poses[:, :-1], poses[:, 1:])[:2] for poses in (course.poses, course.true))
    alarms = np.array([verdict in ALARMS for verdict in course.verdicts])
    nees_mean, low, high = block_nees(course)
    return {
        "m": float(np.sqrt(np.mean(position**2))),
        "deg": math.degrees(np.sqrt(np.mean(heading**2))),
        "NEES": nees_mean,
        "low": low,
        "high": high,
        "teleports": float(np.sum(np.hypot(*(estimated - made)) > TELEPORT_M)),
        "wrong %": 100.0 * float(np.mean(wrong)),
        "and tracking %": 100.0 * float(np.mean(wrong & tracking)),
        "alarm %": 100.0 * float(np.mean(alarms)),
        "tracking %": 100.0 * float(np.mean(tracking)),
    }


def table(name: str, rows: Iterator[tuple[str, list[dict[str, float]]]]) -> None:
    """Print a row for each name: means, and the upper ends of their intervals in brackets."""
    print(f"\n{name}", flush=True)
    for index, (label, trials) in enumerate(rows):
        if not trials:
            continue
        if index == 0:
            print("  ".join(f"{column:>17}" for column in ("", "trials", *trials[0])))
        cells = []
        for column in trials[0]:
            values = np.array([trial[column] for trial in trials if not math.isnan(trial[column])])
            about = mean(values) if values.size else None
            cells.append("-" if about is None else f"{about.mean:.4g} ({about.high:.4g})")
        print("  ".join(f"{cell:>17}" for cell in (label, str(len(trials)), *cells)), flush=True)


def accuracy(options: argparse.Namespace) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """Yield each log's figures, tracked from its known start to its end."""
    for name in LOGS:
        if not name.startswith(options.only):
            continue
        log = log_named(name)
        trial = Trial(log.records[log.scans[0] :], grid_of(log.facts.files))
        start = known_start(trial.records[0])
        yield name, [figures(course_of(trial, seed, [start, *options.set])) for seed in seeds(options)]


def stress(options: argparse.Namespace) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """Yield the figures of each stress, on stretches of the logs that the seed chooses in turn; at last the alcoves."""
    for name, change in STRESSES.items():
        for of in STRESSED:
            label = f"{name}, {of}"
            if label.startswith(options.only):
                yield label, [figures(_stressed(log_named(of), change, seed, options.set)) for seed in seeds(options)]
    if "alcoves".startswith(options.only):
        yield "alcoves", [figures(_in_alcoves(seed, options.set)) for seed in seeds(options)]


def _stressed(log: LaserLog, change: Callable[..., Trial], seed: int, overrides: Sequence[str]) -> Course:
    random, scans = np.random.default_rng(seed), log.scans
    first = int(random.integers(max(len(scans) - STRETCH, 1)))
    last = scans[min(first + STRETCH, len(scans)) - 1]
    records = log.records[scans[first] : last + 1]
    trial = change(Trial(records, grid_of(log.facts.files)), random)
    return course_of(trial, seed, [known_start(records[0]), *overrides])


def _in_alcoves(seed: int, overrides: Sequence[str]) -> Course:
    trial = alcoves(np.random.default_rng(seed))
    first = next(index for index, record in enumerate(trial.records) if record.truth is not None)
    return course_of(
        trial._replace(records=trial.records[first:]), seed, [known_start(trial.records[first]), *overrides]
    )


def kidnap(options: argparse.Namespace) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """Yield how kidnappings of 5 m end: found within twenty updates or not, and the scans wrong and "tracking" then."""
    for name in ("intel", "intel-split", "freiburg-split"):
        if name.startswith(options.only):
            log = log_named(name)
            yield name, [_kidnapped(log, seed, options.set) for seed in seeds(options)]


def _kidnapped(log: LaserLog, seed: int, overrides: Sequence[str]) -> dict[str, float]:
    random, scans = np.random.default_rng(seed), log.scans
    positions = np.array([log.records[index].truth for index in scans])[:, :2]
    last = len(scans) - LEAD
    able = [k for k in range(LEAD, last) if np.hypot(*(positions[k:last] - positions[k]).T).max() > FAR_M]
    at = able[int(random.integers(len(able)))]
    begin = scans[at - LEAD]
    records = kidnapped(log.records, scans[at], FAR_M)[begin:]
    trial = Trial(records, grid_of(log.facts.files))
    course = course_of(trial, seed, [known_start(records[0]), *overrides], lambda count: count >= LEAD + 2 * WITHIN)
    position, heading = course.errors
    near = (position <= FOUND_M) & (heading <= FOUND_RAD)
    after = next((k for k in range(LEAD, near.size) if near[k : k + 5].all()), None)
    updates = math.nan if after is None else course.updates[after] - course.updates[LEAD - 1]
    wrong = ~near & np.array([verdict == "tracking" for verdict in course.verdicts])
    told = next((k for k in range(LEAD, near.size) if course.verdicts[k] in ALARMS), None)
    return {
        "found %": 100.0 * float(updates <= WITHIN),
        "updates": float(updates),
        "told after": math.nan if told is None else float(course.updates[told] - course.updates[LEAD - 1]),
        "wrong, tracking": float(np.sum(wrong[LEAD:])),
        "false alarm %": 100.0 * float(any(verdict in ALARMS for verdict in course.verdicts[:LEAD])),
    }


def landmarks(options: argparse.Namespace) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """Yield the landmark logs' figures: stretches of 300 s of data set 9's robot 3, and the whole of data set 7."""
    folder = str(data_path("logs: mrclam-9-3", sources().landmark["mrclam-9-3"].folder, ""))
    parts = [("9, robot 3", folder, 3, 300.0, 20)]
    parts += [(f"7, robot {robot}", f"{folder}/../MRCLAM_Dataset7", robot, 885.0, 1) for robot in range(1, 6)]
    for label, path, robot, length, most in parts:
        if not label.startswith(options.only):
            continue
        log = opened(path, robot)
        found = []
        for seed in seeds(options):
            stretch = stretches(log, most, length)[(seed - 1) % most]
            run = follow(log, stretch, seed, options.set)
            scored = score(run.estimate, log.truth, heading_valid=log.heading_valid, max_gap=0.5)
            found.append({"m": scored.position_rmse_m, "deg": math.degrees(scored.heading_rmse_rad)})
        yield label, found


def seeds(options: argparse.Namespace) -> range:
    """Return the seeds."""
    return range(options.first, options.first + options.seeds)


PARTS = {"accuracy": accuracy, "stress": stress, "kidnap": kidnap, "landmarks": landmarks}


def main() -> None:
    """Print the tables that the command line asks for, by default all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=[], metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    for name in options.parts or PARTS:
        table(name, PARTS[name](options))


if __name__ == "__main__":
    main()
