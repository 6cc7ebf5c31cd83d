"""The laser logs that studies know by name, from the project's data; any other is a recording that was imported."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.importers.maps import map_attachments
from dynpf_formats.recording.attachments import attached
from dynpf_formats.recording.header import Attachment
from dynpf_protocol.errors import UsageError

from dynpf_lab.studies.laser_runs import LaserLog, imported_log, read_laser_log, split

__all__ = ["DATA", "NAMED", "log_named"]

DATA = Path(__file__).parents[3] / "../shared/data"

MAP_M = 0.05
"""Cells of the maps that are drawn from a log's own scans at their reference poses."""


@cache
def log_named(name: str) -> LaserLog:
    """Return a log by its name, or from the path of an imported recording; raises UsageError where there is none."""
    if name in NAMED:
        source, read = NAMED[name]
        if not (DATA / source).is_file():
            raise UsageError(
                f"logs: {name} is read from {DATA / source}, which is not there; --set \"logs=['IN.mcap']\" takes"
                " recordings that dynpf import has made"
            )
        return read()
    if not Path(name).is_file():
        raise UsageError(f"logs: {name} is neither a file nor one of {', '.join(NAMED)}")
    return read_laser_log(Path(name))


def _carmen(name: str, source: str) -> LaserLog:
    path = DATA / source
    drawn = drawn_map(lambda: import_carmen(path).records, MAP_M, "map")
    return imported_log(name, import_carmen(path, attachments=drawn))


def _intel() -> LaserLog:
    return _carmen("intel", INTEL)


def _intel_split() -> LaserLog:
    return split(log_named("intel"), MAP_M)


def _freiburg_split() -> LaserLog:
    return split(_carmen("freiburg", FREIBURG), MAP_M)


def _jarvis() -> LaserLog:
    """Return the log of an AGV; where its map lies in the reference's frame, and its lag, are those of the data."""
    # The package rosbags is needed for this one alone.
    from dynpf_formats.importers.rosbag import BagChoice, import_rosbag  # noqa: PLC0415

    choice = BagChoice(truth_offset=(-14.48, -3.79, 0.0313), truth_shift=0.08)
    drawn = map_attachments(DATA / "bags/drl/i-108_10mm.yaml")
    return imported_log("jarvis", import_rosbag(DATA / JARVIS, choice, attachments=drawn))


def _simpath() -> LaserLog:
    """Return a simulated log, with its map at the scale and place that the simulator had given it.

    Stage stretches the occupied pixels of a drawing, here 582 of 602, to the floor plan's full size, and puts their
    middle into the origin; the YAML file beside the drawing knows nothing of that. The corner is fitted to the scans
    at the reference poses; so is the reference's lag.
    """
    from dynpf_formats.importers.rosbag import BagChoice, import_rosbag  # noqa: PLC0415

    text = (
        "image: meeting.pgm\nresolution: 0.0517\norigin: [-15.5817, -15.8077, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    image = (DATA / "bags/uob_pioneer/meeting.pgm").read_bytes()
    placed: tuple[Attachment, ...] = attached("meeting.yaml", text.encode()), attached("meeting.pgm", image)
    return imported_log("simpath2", import_rosbag(DATA / SIMPATH, BagChoice(truth_shift=-0.022), attachments=placed))


INTEL = "carmen/intel-corrected.log.gz"
FREIBURG = "carmen/freiburg-101-corrected.log.gz"
JARVIS = "bags/drl/jarvis_circular_path_fast.bag"
SIMPATH = "bags/uob_pioneer/simpath2.bag"

NAMED: Mapping[str, tuple[str, Callable[[], LaserLog]]] = {
    "intel": (INTEL, _intel),
    "intel-split": (INTEL, _intel_split),
    "freiburg-split": (FREIBURG, _freiburg_split),
    "jarvis": (JARVIS, _jarvis),
    "simpath2": (SIMPATH, _simpath),
}
"""The source of each, below DATA, and how it is read."""
