"""A run that goes on, as commands name it: by its folder, by the recording that is being written, or by its address."""

import argparse
from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dynpf_protocol.errors import DynpfError, UsageError

from dynpf_lab.cli.arguments import endpoint as checked_endpoint

if TYPE_CHECKING:
    from dynpf_services.scenario.schema import Scenario

__all__ = ["Target", "scenario_of", "target_of"]


class Target(NamedTuple):
    """The run: its folder or its recording, which need not be there yet; either may be None."""

    folder: Path | None
    recording: Path | None


def target_of(options: argparse.Namespace) -> Target:
    """Return what the command line names, and take address and keys from a run's folder."""
    from dynpf_formats.regular_files import exists
    from dynpf_runtime.bus.run_folder import GUEST_KEYS, read_place

    path: Path | None = options.recording
    if path is None or not path.is_dir():
        if path is not None and not exists(path):
            raise UsageError(f"{path}: no such file; name the recording that is being written, or the run's folder")
        return Target(None, path)
    place = read_place(path)
    if options.connect is None:
        options.connect = checked_endpoint(place.endpoint)
    if options.keys is None and options.connect.startswith("tls/"):
        options.keys = path / GUEST_KEYS
    return Target(path, Path(place.recording))


def scenario_of(target: Target, text: str, endpoint: str, allow_code: Container[str], use: str) -> "Scenario":
    """Return the scenario of the run, with the files that it names; ``use`` says what runs code of the user's."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_runtime.bus.run_folder import SCENARIO_FILE
    from dynpf_services.scenario.load import load_scenario
    from dynpf_services.scenario.recorded import described_scenario
    from dynpf_services.scenario.replay import scenario_of_replay
    from dynpf_services.scenario.user_code import check_allowed

    where = f"the run at {endpoint}"
    if target.folder is not None:
        scenario = load_scenario(str(target.folder / SCENARIO_FILE), allow_code=allow_code)
    elif target.recording is not None:
        return scenario_of_replay(read_recording(target.recording, allow_truncated=True), allow_code=allow_code)
    else:
        try:
            scenario = described_scenario(text, (), where, allow_code=allow_code)
        except DynpfError as error:
            raise UsageError(f"{error}; name the recording that is being written, which has it: RUN.mcap") from error
    check_allowed(scenario.user_classes, scenario.user_code, where, use)
    return scenario
