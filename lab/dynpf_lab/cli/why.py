"""``dynpf why``: when a run could not but fail any more, and the cause."""

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json, add_recording, positive_count
from dynpf_lab.cli.options import add_allow_code, add_code

if TYPE_CHECKING:
    from dynpf_experiments.why.asking import Answer
    from dynpf_experiments.why.causes import Cause
    from dynpf_experiments.why.figure import Bar
    from dynpf_experiments.why.search import Interval, Named, Share

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf why``."""
    parser.description = (
        "Lets futures branch from a recorded lockstep run, with other random numbers, or with one scheduled event, "
        "fault, or stretch of an input or decision left out, and counts how many fail as the run did. The ticks in "
        "which failure became inevitable are found by bisection, and the cause is what averts it if it is left out."
    )
    add_recording(parser)
    parser.add_argument(
        "--when",
        required=True,
        metavar="CONDITION",
        help="what a failure is: position_error (m), heading_error (rad), time (s), tick, or TOPIC.FIELD such as "
        'truth/robot.x, compared by < <= > >= == != with a number or a "word", joined by and, or, not and '
        "brackets",
    )
    parser.add_argument(
        "--futures", type=positive_count, default=200, metavar="N", help="how many futures at most (default: 200)"
    )
    parser.add_argument(
        "--within",
        type=positive_count,
        default=100,
        metavar="TICKS",
        help="a future that has not failed so long after the run did, does not fail (default: 100)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="seed of the futures' seeds (default: 1)")
    parser.add_argument(
        "--jobs",
        type=positive_count,
        metavar="N",
        help="number of processes, without effect on the results (default: all cores)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FIGURE.svg", help="draw what was found")
    add_allow_code(parser)
    add_code(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf why`` and return its exit code."""
    # A snapshot may be anybody's work: no index in it leads a kernel out of an array. Read when numba is imported.
    os.environ["NUMBA_BOUNDSCHECK"] = "1"
    from dynpf_experiments.why.asking import Effort, ask_why
    from dynpf_experiments.why.figure import draw
    from dynpf_formats.recording.reader import read_recording
    from dynpf_formats.regular_files import exists
    from dynpf_runtime.progress import Share
    from dynpf_services.scenario.user_code import add_folders, code_folders

    add_folders(code_folders(options.code))
    if options.output is not None and options.output.suffix != ".svg":
        raise UsageError(f"{options.output}: the figure is an SVG file; end its name with .svg")
    if options.output is not None and exists(options.output):
        raise UsageError(f"{options.output}: the file exists; choose another name")
    recording = read_recording(options.recording)
    effort = Effort(options.futures, options.within, options.jobs or os.cpu_count() or 1, options.seed)
    with Share(options.futures, "futures at most") as progress:
        answer = ask_why(recording, options.when, effort, allow_code=options.allow_code, show=progress.show)
    if options.output is not None:
        bars = list(_bars(answer))
        title = f"{options.recording.name}: {options.when}"
        options.output.write_text(draw(title, answer.failure.tick, answer.reasons, bars), encoding="utf-8")
    if options.json:
        print(json.dumps(_document(answer)))
    else:
        for line in _lines(answer, options):
            print(line)
    return 0 if answer.reasons.interval is not None and not answer.reasons.exhausted else 1


def _lines(answer: "Answer", options: argparse.Namespace) -> Iterator[str]:
    failure, reasons = answer.failure, answer.reasons
    values = ", ".join(
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in failure.values.items()
        if name not in {"tick", "time"}
    )
    yield f"fails        in tick {failure.tick}, {answer.seconds(failure.tick):.3f} s after the first: {values}"
    if reasons.interval is None:
        yield "inevitable   from the first tick on, as far as it was varied: nothing averts it"
    else:
        yield f"inevitable   {_ticks(reasons.interval, answer)}"
    if reasons.shares:
        yield "chance       " + (
            "decides: with other random numbers" if reasons.chance is not None else "does not decide: with others"
        )
        for share in reasons.shares:
            yield f"               from tick {share.tick} on {_share(share)}"
    for node, share in reasons.by_node:
        yield f"               from tick {share.tick} on, of {node} alone, {_share(share)}"
    if not reasons.causes:
        yield "cause        nothing that was left out averts it more often than chance"
    for named in reasons.causes:
        yield f"cause        {_cause(named.cause)}; too late to leave it out: {_ticks(named.interval, answer)}"
        yield f"               without it {_share(named.left_out)}, with it {_share(named.kept)}"
    yield f"futures      {reasons.futures} of at most {options.futures}"
    if reasons.exhausted:
        yield "             The budget is spent; more of them (--futures) tell more."


def _ticks(interval: "Interval", answer: "Answer") -> str:
    first, last = interval.first, interval.last
    times = f"{answer.seconds(first):.3f} s"
    if first == last:
        return f"in tick {first}, at {times}"
    return f"in ticks {first} to {last}, {times} to {answer.seconds(last):.3f} s"


def _share(share: "Share") -> str:
    _, low, high = share.proportion
    return f"{share.failed} of {share.trials} fail ({100 * low:.0f} to {100 * high:.0f} %)"


def _cause(cause: "Cause") -> str:
    from dynpf_experiments.why.causes import Event

    if isinstance(cause, Event):
        return f"{cause.key} of the scenario" + (f", tick {cause.tick}" if cause.node else "")
    return f"{cause.way.kind} {cause.way.topic}, ticks {cause.first} to {cause.last}"


def _bars(answer: "Answer") -> "Iterator[Bar]":
    from dynpf_experiments.why.figure import Bar

    for named in answer.reasons.causes:
        yield Bar(f"without {_cause(named.cause)}", named.left_out, averts=True)
        yield Bar("with it", named.kept, averts=False)
    for node, share in answer.reasons.by_node:
        yield Bar(f"other random numbers of {node}", share, averts=share.failed < share.trials)


def _document(answer: "Answer") -> dict[str, Any]:
    failure, reasons = answer.failure, answer.reasons
    return {
        "failed": {"tick": failure.tick, "seconds": answer.seconds(failure.tick), "values": dict(failure.values)},
        "inevitable": None if reasons.interval is None else [reasons.interval.first, reasons.interval.last],
        "chance": None if reasons.chance is None else [reasons.chance.first, reasons.chance.last],
        "shares": [_numbers(share) for share in reasons.shares],
        "nodes": {node: _numbers(share) for node, share in reasons.by_node},
        "causes": [_named(named) for named in reasons.causes],
        "futures": reasons.futures,
        "exhausted": reasons.exhausted,
    }


def _named(named: "Named") -> dict[str, Any]:
    from dynpf_experiments.why.causes import Event

    cause = named.cause
    if isinstance(cause, Event):
        told: dict[str, Any] = {"kind": "event" if cause.node else "fault", "key": cause.key, "tick": cause.tick}
    else:
        told = {"kind": cause.way.kind, "topic": cause.way.topic, "ticks": [cause.first, cause.last]}
    interval = [named.interval.first, named.interval.last]
    return {**told, "inevitable": interval, "without": _numbers(named.left_out), "with": _numbers(named.kept)}


def _numbers(share: "Share") -> dict[str, Any]:
    rate, low, high = share.proportion
    return {"tick": share.tick, "failed": share.failed, "trials": share.trials, "share": rate, "low": low, "high": high}
