"""Runs as files for Foxglove, Lichtblick and Rerun."""

import errno
from pathlib import Path

from dynpf_experiments.extras import needing
from dynpf_experiments.measures import measure
from dynpf_experiments.pictures.whole import whole
from dynpf_experiments.viewers.items import items
from dynpf_formats.recording.info import title_of
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import ScenarioError

__all__ = ["export"]


def export(recording: Recording, viewer: str, path: Path) -> int:
    """Write a recording for a viewer, "foxglove" or "rerun", and return the number of messages.

    Raises UsageError where the viewer's package is not installed, OSError where the file is there or cannot be written.
    """
    if path.exists():
        raise FileExistsError(errno.EEXIST, "the file exists", str(path))
    try:
        measures = measure(recording)
    except ScenarioError:  # an imported log
        measures = {}
    if viewer == "foxglove":
        with needing("foxglove", extra="foxglove", what="writing for Foxglove"):
            from dynpf_experiments.viewers.foxglove import write_foxglove
        return write_foxglove(items(whole(recording), measures), path)
    with needing("rerun", extra="rerun", what="writing for Rerun"):
        from dynpf_experiments.viewers.rerun import write_rerun
    digest = str(measures.get("content_digest", path.stem))
    return write_rerun(items(whole(recording), measures), path, name=title_of(recording), digest=digest)
