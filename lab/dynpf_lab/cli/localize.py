"""``dynpf localize``: from a robot's log to a verdict in one command."""

import argparse
import json
import math
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json, finite_number
from dynpf_lab.cli.loading import loading
from dynpf_lab.cli.page import add_no_page, leave_page

if TYPE_CHECKING:
    from dynpf_formats.importers.log import ImportSummary
    from dynpf_systems.rooms.amcl.reading import Parameters

    from dynpf_lab.localize.localizing import Judged, Plan

__all__ = ["add_arguments"]

LAST = "last_pose.json"
WIDTH = 120


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf localize``."""
    parser.description = (
        "Imports the log, checks frames, chooses scenario and start by what the log holds, runs it in one process, and "
        "says whether the robot was localized. The exit code is 0 if it was, else 1."
    )
    parser.add_argument(
        "source",
        metavar="LOG",
        type=Path,
        help="ROS bag (1 or 2), CARMEN log, folder of MRCLAM, or a recording that dynpf import made",
    )
    parser.add_argument("--map", metavar="YAML", type=Path, help="map of map_server; else the log's own")
    parser.add_argument("--amcl", metavar="PARAMS.yaml", type=Path, help="filter as these parameters of AMCL say")
    parser.add_argument(
        "-o", "--output", metavar="FOLDER", type=Path, help="where log, run and page are written (default: runs/NAME)"
    )
    parser.add_argument(
        "--start",
        choices=["auto", "search", "last"],
        default="auto",
        help="auto: AMCL's initial pose, the robot's own first pose or the reference's, if the first scans say so, "
        f"else a search of the map; last: the pose in FOLDER/{LAST}, where the run before it ended",
    )
    parser.add_argument(
        "--start-pose", metavar=("X", "Y", "THETA"), nargs=3, type=finite_number, help="pose at the start (m, m, rad)"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of everything random in the run")
    add_no_page(parser)
    add_json(parser, "print what was found as one JSON document")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf localize`` and return its exit code."""
    with loading():
        from dynpf_formats.recording.reader import read_recording
        from dynpf_services.scenario.build import build_nodes
        from dynpf_services.scenario.played_log import PlayedLog

        from dynpf_lab.cli.run import run_in_process, tell_doubts
        from dynpf_lab.localize.localizing import judged, last_pose, planned
    if options.start_pose is not None and options.start != "auto":
        raise UsageError(f"--start-pose and --start {options.start}: give one of them")
    folder = _folder(options)
    parameters = _parameters(options)
    path, summary = _imported(options, folder, parameters)
    log = PlayedLog(path)
    name = options.source.name.partition(".")[0] or "log"
    amcl = (
        None
        if parameters is None
        else (parameters, _scenario(parameters, options, log, _unused(folder, name, ".toml")))
    )
    start = options.start if options.start_pose is None else options.start_pose
    with loading():
        plan = planned(log, amcl=amcl, start=start, last=folder / LAST, seed=options.seed)
        tell_doubts("localize", build_nodes(plan.scenario).values())
    output = _unused(folder, name, ".run.mcap")
    run_in_process(plan.scenario, output, log)
    recording = read_recording(output)
    judgement = judged(recording, log, plan)
    page = None if options.no_page else leave_page("localize", output, recording, judgement.measures)
    found: dict[str, Any] = {"log": str(path), "recording": str(output), "page": None if page is None else str(page)}
    pose = last_pose(recording, plan) if judgement.verdict.localized else None
    if pose is not None:
        (folder / LAST).write_text(json.dumps({field: getattr(pose, field) for field in pose.__struct_fields__}) + "\n")
        found["last_pose"] = {"x": pose.x, "y": pose.y, "theta": pose.theta, "file": str(folder / LAST)}
    print(_json(found, judgement, plan) if options.json else "\n".join(_lines(found, summary, judgement, plan)))
    return 0 if judgement.verdict.localized else 1


def _folder(options: argparse.Namespace) -> Path:
    folder: Path = options.output or Path("runs") / (options.source.name.partition(".")[0] or "log")
    if not options.source.exists():
        raise UsageError(f"{options.source}: no such file or folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}; choose the folder with -o") from error
    return folder


def _unused(folder: Path, stem: str, suffix: str) -> Path:
    """Return the path of a file that is not there yet: earlier runs are kept."""
    path, number = folder / f"{stem}{suffix}", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path


def _parameters(options: argparse.Namespace) -> "Parameters | None":
    from dynpf_lab.cli.import_amcl import read_amcl

    return None if options.amcl is None else read_amcl(options.amcl)


def _imported(
    options: argparse.Namespace, folder: Path, parameters: "Parameters | None"
) -> "tuple[Path, ImportSummary | None]":
    """Return the log as a recording of ours, and what was made of it."""
    from dynpf_formats.importers.recording import write_recording

    from dynpf_lab.localize.sources import imported, source_of

    scan = str(parameters.values["scan_topic"]) if parameters and "scan_topic" in parameters.given else None
    log = imported(source_of(options.source), options.map, scan)
    if log is None:
        return options.source, None
    path = _unused(folder, options.source.name.partition(".")[0] or "log", ".log.mcap")
    return path, write_recording(log, path)


def _scenario(parameters: "Parameters", options: argparse.Namespace, log: Any, path: Path) -> Path:
    """Write the scenario of AMCL's parameters; limits that the scanner itself keeps are left out, as AMCL does."""
    from dynpf_formats.regular_files import readable
    from dynpf_systems.rooms.amcl.scenario import scenario_of, toml_of

    from dynpf_lab.localize.starting import scans_in

    scenario = scenario_of(parameters, readable(options.amcl.name))
    estimator = scenario["estimator"]
    for _, scan in scans_in(log.records, 1):
        if estimator.get("scan_range_max", 0.0) >= scan.range_max:
            del estimator["scan_range_max"]
        if estimator.get("scan_range_min", math.inf) <= scan.range_min:
            del estimator["scan_range_min"]
    path.write_text(toml_of(scenario))
    return path


def _lines(found: Mapping[str, Any], summary: "ImportSummary | None", judgement: "Judged", plan: "Plan") -> list[str]:
    from dynpf_experiments.measures import lines_of

    from dynpf_lab.localize.localizing import in_words

    lines = [f"log         {found['log']}"]
    if summary is not None:
        counts = ", ".join(f"{count} {topic.removeprefix('log/')}" for topic, count in summary.messages.items())
        lines.append(f"            {summary.source} ({summary.format}), {summary.duration_s:.1f} s: {counts}")
        lines += [
            f"            left out: {lost.count} {why} (first: {lost.first})" for why, lost in summary.dropped.items()
        ]
        lines += [f"            warning: {text}" for text in summary.warnings]
        if "map_from_poses" in summary.settings:
            lines.append("map         drawn from the scans of this very log at its reference poses: the errors flatter")
    told = in_words(judgement, plan)
    lines.append(f"scenario    {plan.name}")
    lines += [f"{name:<12}{text}" for name, text in told.items() if name != "fit"]
    lines += [*_errors(judgement, lines_of), *(f"{name:<12}{text}" for name, text in told.items() if name == "fit")]
    if plan.walls is None:
        lines.append("fit         no map, so nothing but filter and reference to judge by")
    lines.append(f"recording   {found['recording']}")
    if found["page"] is not None:
        lines.append(f"page        {found['page']}")
    if "last_pose" in found:
        pose = found["last_pose"]
        where = f"({pose['x']:.2f} m, {pose['y']:.2f} m, {pose['theta']:.2f} rad)"
        lines.append(f"last pose   {where} is kept in {pose['file']}; --start last begins the next log there")
    lines.append(f"verdict     {judgement.verdict.text}")
    return [part for line in lines for part in _folded(line)]


def _folded(line: str) -> list[str]:
    """Return a line in lines of at most WIDTH characters, but for words that are longer."""
    return textwrap.wrap(line, WIDTH, subsequent_indent=" " * 12, break_long_words=False, break_on_hyphens=False)


def _errors(judgement: "Judged", lines_of: Any) -> list[str]:
    """Return the lines of the errors; of a reference in another frame those after alignment alone."""
    if judgement.aligned is None:
        return list(lines_of(judgement.measures))
    shown = {name: value for name, value in judgement.aligned.items() if name != "alignment"}
    moved = judgement.measures.get("alignment", {}).get("truth_offset")
    where = "" if moved is None else " by --truth-offset {:.4f} {:.4f} {:.5f}".format(*moved)
    lines = list(lines_of(shown))
    if "position_rmse_m" in shown:
        lines.append(f"            against the reference moved into the estimate's frame{where}")
    return lines


def _json(found: Mapping[str, Any], judgement: "Judged", plan: "Plan") -> str:
    verdict = judgement.verdict
    document = {
        **found,
        "scenario": plan.name,
        "start": {
            "kind": "search" if plan.start.pose is None else "known",
            "pose": plan.start.pose,
            "why": plan.start.why,
        },
        "frames": _finite_of(plan.frames._asdict()),
        "fit": _finite_of(judgement.fit._asdict()),
        "measures": judgement.measures,
        "measures_aligned": judgement.aligned,
        "localized": verdict.localized,
        "verdict": verdict.text,
        "shares": verdict.shares,
        "spans": [span._asdict() for span in verdict.spans],
    }
    return json.dumps(document)


def _finite_of(figures: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in figures.items()
    }
