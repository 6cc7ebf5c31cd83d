"""The figures of a run in Python: each method returns a matplotlib figure, to be shown, changed or saved."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from dynpf_experiments.pictures.whole import Whole, whole
from dynpf_experiments.plots.animation import animate
from dynpf_experiments.plots.figures import MOVING, figure
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import UsageError

__all__ = ["Plots"]


class Plots:
    """The figures of ``dynpf plot``.

    They need matplotlib, which ``pip install 'dynpf-lab[figures]'`` adds. Raises UsageError without it, and for a
    figure that the run has nothing for.
    """

    def __init__(self, recording: Callable[[], Recording]) -> None:
        self._recording = recording

    @cached_property
    def _whole(self) -> Whole:
        return whole(self._recording())

    def overview(self) -> Any:
        """Return the world with paths, the position error with 3 sigma, and the filters' health."""
        return figure(self._whole, "overview")

    def trajectory(self) -> Any:
        """Return the world from above with true, estimated and dead-reckoned paths."""
        return figure(self._whole, "trajectory")

    def errors(self) -> Any:
        """Return errors of position and heading over time, with 3 sigma, and the NEES with its band."""
        return figure(self._whole, "errors")

    def filters(self) -> Any:
        """Return effective sample size, evidence, commands and what a system plots of its own over time."""
        return figure(self._whole, "filters")

    def health(self) -> Any:
        """Return the filters' verdicts over time, above the position error."""
        return figure(self._whole, "health")

    def particles(self) -> Any:
        """Return the world with particles and the robot at six moments."""
        return figure(self._whole, "particles")

    def film(self, path: str | Path) -> Path:
        """Write the run as it goes, from above, into a .gif or .mp4 and return its path."""
        target = Path(path)
        if target.suffix not in MOVING:
            raise UsageError(f"{path}: ends in {target.suffix!r}; expected one of {', '.join(MOVING)}")
        animate(self._whole, target)
        return target
