"""``dynpf fit``: the parameters of the beam model, from a recorded run."""

import argparse
import json

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf fit``."""
    parser.description = (
        "Fits by expectation maximization to all ranges of the run's scans, at the true poses in the run's map; "
        "prints the table for a scenario."
    )
    add_recording(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf fit`` and return its exit code."""
    import msgspec
    from dynpf_formats.recording.reader import read_recording
    from dynpf_systems.rooms.studies.beam_fit import fit_recording

    fit = fit_recording(read_recording(options.recording))
    params = {"kind": "beam", **{name: getattr(fit.params, name) for name in fit.params.__struct_fields__}}
    if options.json:
        found = {"used": fit.used, "iterations": len(fit.log_likelihoods) - 1, "converged": fit.converged}
        print(json.dumps(msgspec.to_builtins(params) | found))
        return 0
    # Four digits exceed the accuracy of a fit; the shares still have to sum to one.
    rounded = {name: round(value, 4) if isinstance(value, float) else value for name, value in params.items()}
    rounded["z_hit"] = round(1.0 - sum(rounded[name] for name in ("z_short", "z_max", "z_rand")), 4)
    print(f"# fitted to {fit.used} ranges in {len(fit.log_likelihoods) - 1} iterations")
    print("[[estimator.measurement]]")
    print("\n".join(f"{name} = {json.dumps(value)}" for name, value in rounded.items()))
    return 0
