"""``dynpf replay --at``: a run branched from its middle, beside the run as it was."""

import argparse
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

if TYPE_CHECKING:
    from dynpf_formats.recording.diff import FirstDifference
    from dynpf_services.scenario.branch import Branched

__all__ = ["print_branch"]


def print_branch(options: argparse.Namespace) -> int:
    """Branch the run, print the first tick that differs and the measures before and after; return the exit code."""
    from dynpf_experiments.measure_table import changes_of
    from dynpf_experiments.measures import measure
    from dynpf_formats.recording.diff import diff
    from dynpf_formats.recording.reader import read_recording
    from dynpf_formats.regular_files import exists
    from dynpf_services.scenario.branch import branch_run, exchange
    from dynpf_services.scenario.replay_part import moment_of

    if options.first is not None or options.last is not None:
        raise UsageError("--at goes on to the end of the run: it goes without --from and --until")
    overrides = [*([] if options.node is None else [exchange(options.node)]), *options.overrides]
    if not overrides:
        raise UsageError("--at: say what changes there, by --set KEY=VALUE or --node NAME=MODULE:CLASS")
    if options.output is not None and exists(options.output):
        raise UsageError(f"{options.output}: the file exists; choose another name")
    recording = read_recording(options.recording)
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        path = options.output or Path(folder) / "branched.mcap"
        branched = branch_run(recording, moment_of(options.at), overrides, options.allow_code, path)
        after = read_recording(path)
        first = diff(recording, after).first
        rows = changes_of(measure(recording), measure(after))
    if options.json:
        print(json.dumps({**_document(branched, first), "metrics": rows}))
    else:
        _print(branched, first, rows, overrides)
    return 0 if first is None else 1


def _document(branched: "Branched", first: "FirstDifference | None") -> dict[str, Any]:
    import msgspec

    told = msgspec.to_builtins(first)
    return {
        "same": first is None,
        "at": branched.at,
        "first": told,
        "changed": branched.changed,
        "fresh": branched.fresh,
    }


def _print(
    branched: "Branched", first: "FirstDifference | None", rows: Mapping[str, Mapping[str, Any]], overrides: list[str]
) -> None:
    from dynpf_experiments.measure_table import before_and_after

    print(f"from tick {branched.at} on with {' '.join(overrides)}")
    for name in branched.fresh:
        print(f"{name} cannot take over the state of the node before it, and begins there in its first state")
    if first is None:
        print("the rest of the run is the same")
    else:
        print(f"first difference: tick {first.tick}, node {first.node}, {first.topic} {first.sequence}, {first.field}")
    print("\n".join(before_and_after(rows)))
