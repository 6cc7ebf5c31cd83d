"""Localizes a robot on its log: the scenario that fits what the log holds, the start that can be believed, the run."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.measures import measure
from dynpf_experiments.messages import recorded
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import Estimate
from dynpf_runtime.source import LogRecord
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.overrides import overrides_of
from dynpf_services.scenario.played_log import PlayedLog, start_by
from dynpf_services.scenario.schema import Scenario
from dynpf_systems.rooms.amcl.reading import Parameters
from dynpf_systems.rooms.amcl.scenario import is_start_given
from dynpf_systems.rooms.fit import fit_where_tracking, poses_at
from dynpf_systems.rooms.maps import OccupancyConfig, open_maps
from dynpf_systems.rooms.measures import LOCALIZED, wrong_share
from dynpf_systems.rooms.measures import aligned as in_frame
from dynpf_systems.rooms.verdict import Fit, Verdict, spans_of, verdict_of
from dynpf_systems.rooms.wall_fit import WallFit

from dynpf.maps.occupancy import OccupancyGrid
from dynpf_lab.localize.starting import (
    LastPose,
    Start,
    digest_of,
    first_fit,
    fits,
    path_in,
    read_last,
    scans_in,
)

__all__ = ["Frames", "Judged", "Plan", "in_words", "judged", "last_pose", "planned"]

LASER, LANDMARKS = "laser-log", "landmark-mrclam"
TRUTH = "log/truth"
SCANS_COMPARED = 60
SPACING_M = 0.4
LEVER_M = 4.0
MOST_CELLS = 5e6
"""Coarse cells of a search: a larger map is searched more coarsely."""

AROUND_LANDMARKS_M = 5.0


class Frames(NamedTuple):
    """Shares of beams that end near walls at the reference's poses, and by chance; whether it is in the map's frame."""

    reference: float
    chance: float
    agree: bool | None  # None: there is no reference, or no map


class Plan(NamedTuple):
    """What is run, and why."""

    scenario: Scenario
    name: str
    start: Start
    frames: Frames
    walls: WallFit | None
    grid: OccupancyGrid | None


class Judged(NamedTuple):
    """What came of a run: ``measures`` as they are, and those in the map's frame where the reference's is another."""

    measures: dict[str, Any]
    aligned: dict[str, Any] | None
    fit: Fit
    verdict: Verdict


def planned(
    log: PlayedLog,
    *,
    amcl: tuple[Parameters, Path] | None,
    start: str | Sequence[float],
    last: Path,
    seed: int,
) -> Plan:
    """Return what to run for a log.

    ``amcl`` are parameters and the scenario that was made of them. ``start`` is auto, search, last (a pose in the file
    ``last``) or a pose. Raises UsageError for a log that no scenario fits, ScenarioError as loading one does.
    """
    topics = log.facts.topics or frozenset()
    if "log/scan" in topics and log.facts.map is not None:
        return _on_map(log, amcl, start, last, seed)
    if amcl is not None:
        raise UsageError("--amcl: the log has no scans, or there is no map for them")
    if "log/landmarks" in topics and log.facts.landmarks:
        if start == "last":
            raise UsageError("--start last: goes with a map, which this log does not have")
        return _among_landmarks(log, start, seed)
    if "log/scan" in topics:
        raise UsageError("the log has scans and no map to localize in: give it with --map map.yaml")
    raise UsageError(
        f"the log has nothing to localize by: neither scans nor landmarks, but {', '.join(sorted(topics))}"
    )


def _on_map(
    log: PlayedLog, amcl: tuple[Parameters, Path] | None, start: str | Sequence[float], last: Path, seed: int
) -> Plan:
    grid = _grid(log)
    walls = WallFit(grid)
    frames = _frames(log.records, walls)
    known = read_last(last, grid) if start == "last" else None
    chosen = _start(log, walls, frames, asked=start, amcl=amcl[0] if amcl else None, last=known)
    settings: dict[str, Any] = {"estimator.start": _table(chosen, grid)}
    name = LASER if amcl is None else str(amcl[1])
    scenario = load_scenario(name, overrides=overrides_of(settings), seed=seed, log=log.facts)
    return Plan(scenario, name, chosen, frames, walls, grid)


def _grid(log: PlayedLog) -> OccupancyGrid:
    assert log.facts.map is not None
    try:
        maps = open_maps(
            OccupancyConfig(file=log.facts.map), None, lambda name: log.facts.files[name.rpartition("/")[2]]
        )
    except (ValueError, KeyError) as error:
        raise UsageError(f"{log.path}: its map {log.facts.map}: {error}") from error
    assert maps.grid is not None
    return maps.grid


def _frames(records: Sequence[LogRecord], walls: WallFit) -> Frames:
    """Return whether the reference's poses are in the frame of the map: then the beams end near its walls."""
    scans = scans_in(records, SCANS_COMPARED)
    chance = walls.by_chance([timed.scan for timed in scans]) if scans else math.nan
    poses, inside = poses_at(path_in(records, TRUTH), np.array([timed.stamp for timed in scans]))
    if not inside.size:
        return Frames(math.nan, chance, None)
    share = walls.share([scans[index].scan for index in inside], poses)
    return Frames(share, chance, fits(share, chance))


def _start(
    log: PlayedLog,
    walls: WallFit,
    frames: Frames,
    *,
    asked: str | Sequence[float],
    amcl: Parameters | None,
    last: LastPose | None,
) -> Start:
    """Return the first pose that the first scans bear out, or the search of the map."""
    if not isinstance(asked, str):
        x, y, theta = asked
        return Start("as --start-pose says", (x, y, theta), 0.5, 0.25)
    if last is not None:
        return Start(f"where {last.recording} ended", (last.x, last.y, last.theta), 0.5, 0.25)
    if asked == "search":
        return Start("as --start search asks")
    refused = []
    for candidate in _candidates(log, frames, amcl):
        assert candidate.pose is not None
        share = first_fit(log.records, walls, candidate.pose)
        if fits(share, frames.chance):
            return candidate
        x, y, _ = candidate.pose
        near = f"{100.0 * share:.0f} % of the first beams end near a wall there"
        refused.append(f"{candidate.why} ({x:.2f}, {y:.2f}) m is not believed, {near}")
    return Start("; ".join(refused) or "no pose is known")


def _candidates(log: PlayedLog, frames: Frames, amcl: Parameters | None) -> Iterator[Start]:
    if amcl is not None and is_start_given(amcl):
        values = amcl.values
        sigma = math.sqrt(0.5 * (values["initial_cov_xx"] + values["initial_cov_yy"]))
        pose = (values["initial_pose.x"], values["initial_pose.y"], values["initial_pose.yaw"])
        yield Start("AMCL's initial_pose", pose, sigma, math.sqrt(values["initial_cov_aa"]))
    found = start_by(log.records, "", LOCALIZED)
    if found is not None:
        yield Start("the first pose of the robot's own localization", found, 0.3, 0.15)
    first = log.facts.starts.get("")
    if first is not None and frames.agree is not False:
        yield Start("the first reference pose", first)


def _table(start: Start, grid: OccupancyGrid) -> dict[str, Any]:
    if start.pose is None:
        free = float(np.count_nonzero(grid.free)) * grid.resolution**2
        spacing = max(SPACING_M, (free * math.tau * LEVER_M / MOST_CELLS) ** (1.0 / 3.0))
        return {"kind": "search", "spacing": round(spacing, 3), "kept": 5000}
    x, y, theta = (float(number) for number in start.pose)
    sigmas = {"sigma_position": start.sigma_m, "sigma_heading": start.sigma_rad}
    return {"kind": "known", "x": x, "y": y, "theta": theta, **sigmas}


def _among_landmarks(log: PlayedLog, asked: str | Sequence[float], seed: int) -> Plan:
    pose = log.facts.starts.get("")
    settings: dict[str, Any] = {}
    if not isinstance(asked, str):
        x, y, theta = asked
        start = Start("as --start-pose says", (x, y, theta))
        settings["estimator.start"] = {"kind": "known", "x": x, "y": y, "theta": theta}
    elif pose is not None and asked == "auto":
        start = Start("the first reference pose", pose)
    else:
        start = Start("from the first readings of landmarks")
        xs, ys = ([float(landmark[axis]) for landmark in log.facts.landmarks] for axis in ("x", "y"))
        box = {
            "x_min": min(xs) - AROUND_LANDMARKS_M,
            "x_max": max(xs) + AROUND_LANDMARKS_M,
            "y_min": min(ys) - AROUND_LANDMARKS_M,
            "y_max": max(ys) + AROUND_LANDMARKS_M,
        }
        settings["estimator.start"] = {"kind": "from_readings", "base": {"box": box}}
    scenario = load_scenario(LANDMARKS, overrides=overrides_of(settings), seed=seed, log=log.facts)
    return Plan(scenario, LANDMARKS, start, Frames(math.nan, math.nan, None), None, None)


def judged(recording: Recording, log: PlayedLog, plan: Plan) -> Judged:
    """Return measures and verdict of a run.

    Where the reference is in another frame than the map, only its shape can be compared: the verdict then rests on the
    measures after alignment.
    """
    run = recorded(recording)
    measures = measure(recording)
    other = plan.frames.agree is False or "alignment" in measures
    aligned = measure(recording, truth_align=True) if other else None
    fit = Fit()
    if plan.walls is not None:
        estimate = fit_where_tracking(run, scans_in(log.records, SCANS_COMPARED), plan.walls)
        fit = Fit(estimate, plan.frames.reference, plan.frames.chance)
    wrong = wrong_share(in_frame(run) if other else run)
    return Judged(measures, aligned, fit, verdict_of(spans_of(run), wrong, fit))


def last_pose(recording: Recording, plan: Plan) -> LastPose | None:
    """Return the last estimate of a run in a map."""
    timed = recorded(recording).topic("estimator/state")
    if plan.grid is None or not timed:
        return None
    state = timed[-1].message
    assert isinstance(state, Estimate)
    return LastPose(
        x=state.x,
        y=state.y,
        theta=state.theta,
        map_sha256=digest_of(plan.grid),
        recording=recording.path.name,
        stamp_ns=timed[-1].stamp_ns,
    )


def in_words(judgement: Judged, plan: Plan) -> Mapping[str, str]:
    """Return what to tell of frames, start and fit, each under its name."""
    frames, start = plan.frames, plan.start
    told: dict[str, str] = {}
    if frames.agree is not None:
        near = f"{100.0 * frames.reference:.0f} % of the beams end near a wall at the reference's poses, "
        near += f"{100.0 * frames.chance:.0f} % would anywhere on the map"
        told["frames"] = f"{near}: the reference is {'' if frames.agree else 'not '}in the map's frame"
    where = "" if start.pose is None else " ({:.2f} m, {:.2f} m, {:.2f} rad)".format(*start.pose)
    told["start"] = f"{'search of the map' if start.pose is None else 'known'}{where}: {start.why}"
    if math.isfinite(judgement.fit.estimate):
        told["fit"] = (
            f"{100.0 * judgement.fit.estimate:.0f} % of the beams end near a wall at the estimates, "
            f"{100.0 * judgement.fit.chance:.0f} % would anywhere on the map"
        )
    return told
