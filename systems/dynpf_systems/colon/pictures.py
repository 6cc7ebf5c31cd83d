"""COLON from above, in pixels of its maps: the capsule, true and estimated; the tubes come from scenes of the nodes."""

from typing import Literal

import numpy as np
from dynpf_experiments.pictures.drawing import Drawing, Line, Pictures, Plot, Track, Unit
from dynpf_experiments.pictures.source import RunSource

from dynpf_systems.colon.messages import CapsuleEstimate, CapsuleState
from dynpf_systems.colon.scene import M_PER_PX

__all__ = ["PICTURES"]

REPLACED = frozenset({"capsule", "estimated capsule"})
PIXEL = Unit("px", 1.0 / M_PER_PX)
MOST_MAPS = 16


def _draw(source: RunSource) -> Drawing | None:
    states = [(at, m) for at, m in source.messages("truth/capsule") if isinstance(m, CapsuleState)]
    estimates = [(at, m) for at, m in source.messages("estimator/capsule") if isinstance(m, CapsuleEstimate)]
    if not states and not estimates:
        return None
    truth = _track("truth", "truth", [(at, m.x_px, m.y_px, m.theta) for at, m in states])
    estimate = _track("estimator", "estimate", [(at, m.x_px, m.y_px, m.theta) for at, m in estimates])
    covariances = np.moveaxis(np.array([m.covariance for _, m in estimates]).reshape(-1, 3, 3), 0, 2)
    estimate = estimate._replace(covariances=covariances)
    posterior = _posterior(estimates)
    seconds = np.array([at for at, _ in estimates])
    n_eff = Line("effective", seconds, np.array([m.n_eff for _, m in estimates]))
    plots = [
        *([posterior] if posterior.lines else []),
        *([Plot("n_eff", "Effective sample size", "", [n_eff])] if estimates else []),
    ]
    return Drawing(unit=PIXEL, tracks=[truth, estimate], plots=plots, replaced=REPLACED)


def _track(name: str, role: Literal["truth", "estimate"], rows: list[tuple[float, float, float, float]]) -> Track:
    table = np.array(rows).reshape(-1, 4)
    return Track(name, role, "", table[:, 0], table[:, 1:].T)


def _posterior(estimates: list[tuple[float, CapsuleEstimate]]) -> Plot:
    """Return the probabilities of the maps over time; no line where no map is estimated."""
    names = list(dict.fromkeys(entry.map for _, estimate in estimates for entry in estimate.maps))[:MOST_MAPS]
    seconds = np.array([at for at, _ in estimates])
    lines = []
    for name in names:
        told = [{entry.map: entry.probability for entry in estimate.maps}.get(name, 0.0) for _, estimate in estimates]
        lines.append(Line(f"map {name}", seconds, np.array(told)))
    return Plot("posterior", "Probability of maps", "", lines, "Which map the readings speak for.")


PICTURES = Pictures(_draw)
