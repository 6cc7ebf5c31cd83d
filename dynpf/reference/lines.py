"""Twin of ``dynpf.kernels.lines`` in double precision."""

import numpy as np

from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = ["log_likelihood"]


def log_likelihood(
    x: Floats,
    y: Floats,
    theta: Floats,
    *,
    rhos: Floats,
    alphas: Floats,
    lengths: Floats,
    segments: Floats,
    sigma_rho: float,
    sigma_alpha: float,
    length_tolerance: float,
    outlier_fraction: float,
    outlier_rho: float,
    middles: Floats | None = None,
    sigma_along: float = 0.0,
) -> FloatArray:
    """Return the log-density of lines (K,) seen at poses (N,) among segments (S, 4) of x1, y1, x2, y2, shape (N,)."""
    total = np.zeros(x.size)
    if middles is None:
        middles = np.zeros_like(rhos)
    for rho, alpha, length, middle in zip(rhos, alphas, lengths, middles, strict=True):
        if not np.isfinite((rho, alpha, length)).all():
            continue
        log_density = np.full(x.size, -np.inf)
        for x1, y1, x2, y2 in segments:
            extent = np.hypot(x2 - x1, y2 - y1)
            if length > extent + length_tolerance:
                continue
            # The segment's line in the robot's frame, its normal pointing to the left of the way from 1 to 2.
            normal = np.arctan2(x2 - x1, y1 - y2)
            expected_rho = (x1 - x) * np.cos(normal) + (y1 - y) * np.sin(normal)
            turned = wrap_angle(alpha - (normal - theta))
            other_side = np.abs(turned) > np.pi / 2
            away = np.where(other_side, rho + expected_rho, rho - expected_rho)
            turned = np.where(other_side, wrap_angle(turned - np.pi), turned)
            squared = (away / sigma_rho) ** 2 + (turned / sigma_alpha) ** 2
            if sigma_along > 0.0:
                # The middle of what was seen, in the map; along the segment, from its middle.
                ahead = np.cos(alpha) * rho - np.sin(alpha) * middle, np.sin(alpha) * rho + np.cos(alpha) * middle
                middle_x = x + np.cos(theta) * ahead[0] - np.sin(theta) * ahead[1]
                middle_y = y + np.sin(theta) * ahead[0] + np.cos(theta) * ahead[1]
                off = (middle_x - (x1 + x2) / 2) * (x2 - x1) + (middle_y - (y1 + y2) / 2) * (y2 - y1)
                beyond = np.abs(off / extent) - 0.5 * (extent + length_tolerance - length)
                squared += (np.maximum(beyond, 0.0) / sigma_along) ** 2
            log_density = np.maximum(log_density, -0.5 * squared - np.log(2.0 * np.pi * sigma_rho * sigma_alpha))
        if outlier_fraction > 0.0:
            log_outlier = np.log(outlier_fraction / (2.0 * np.pi * outlier_rho))
            log_density = np.logaddexp(np.log1p(-outlier_fraction) + log_density, log_outlier)
        total += log_density
    return total
