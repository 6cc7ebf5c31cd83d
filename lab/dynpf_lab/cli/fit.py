"""``dynpf fit``: the parameters of the beam model, from a recorded run."""

import argparse
import json
from pathlib import Path
from typing import Any

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser(
        "fit",
        help="the beam model's parameters from a recorded run",
        description="By expectation maximization over every range of the run's scans, taken at the true poses in the "
        "run's map; prints the table for a scenario.",
    )
    parser.add_argument("recording", type=Path, metavar="RUN.mcap")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    import msgspec
    from dynpf_formats.recording.reader import read_recording
    from dynpf_systems.rooms.studies.beam_fit import fit_recording

    fit = fit_recording(read_recording(options.recording))
    params = {"kind": "beam", **{name: getattr(fit.params, name) for name in fit.params.__struct_fields__}}
    if options.json:
        found = {"used": fit.used, "iterations": len(fit.log_likelihoods) - 1, "converged": fit.converged}
        print(json.dumps(msgspec.to_builtins(params) | found))
        return 0
    # Four digits are more than a fit tells; the shares still have to sum to one.
    rounded = {name: round(value, 4) if isinstance(value, float) else value for name, value in params.items()}
    rounded["z_hit"] = round(1.0 - sum(rounded[name] for name in ("z_short", "z_max", "z_rand")), 4)
    print(f"# fitted to {fit.used} ranges in {len(fit.log_likelihoods) - 1} iterations")
    print("[[estimator.measurement]]")
    print("\n".join(f"{name} = {json.dumps(value)}" for name, value in rounded.items()))
    return 0
