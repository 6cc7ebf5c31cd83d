"""Runs that pages are made of, each made once."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from dynpf_experiments.measures import measure
from dynpf_experiments.pictures.page import RunPicture, run_picture
from dynpf_experiments.pictures.source import Budget
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.notebook import run

RECORDINGS = Path(__file__).parents[3] / "recordings"


@cache
def short_run(name: str, ticks: int) -> Recording:
    """Return a run of a shipped scenario, of so many ticks."""
    folder = Path(mkdtemp(prefix="dynpf-test-"))
    path = folder / f"{name}.mcap"
    run(name, settings={"max_ticks": ticks}, path=path)
    return read_recording(path)


def recorded(name: str) -> Recording:
    """Return a reference recording."""
    return read_recording(RECORDINGS / f"{name}.mcap")


def picture(recording: Recording, budget: Budget | None = None) -> RunPicture:
    """Return what a page shows of a recording."""
    return run_picture(recording, measure(recording), budget or Budget())
