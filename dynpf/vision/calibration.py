"""Calibration: from known points in the workspace and where they appear, to the map between them."""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.directions import directions
from dynpf.portable import norm, singular_values
from dynpf.portable.functions import as_values
from dynpf.vision.circle import fit_circles, fit_circles_algebraic
from dynpf.vision.discs import Disc
from dynpf.vision.projection import PlaneProjection
from dynpf.vision.subsample import to_full_px

__all__ = ["Calibration", "CalibrationError", "WorkspaceDisc", "calibrate"]

_MIN_PAIRS = 6
_RIM_POINTS = 32


class CalibrationError(ValueError):
    """The pairs do not determine the map from pixels to the workspace."""


class WorkspaceDisc(msgspec.Struct, frozen=True):
    """A disc in the workspace, metres."""

    x: float
    y: float
    radius: float


class Calibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fitted camera; `rms_px` and `rms_m` are what it leaves of the pairs it was fitted to."""

    projection: PlaneProjection
    rms_px: float
    rms_m: float

    def to_workspace(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map pixels (K, 2) of the frame to metres (K, 2)."""
        return self.projection.to_workspace(points_px)

    def disc_to_workspace(self, disc: Disc, subsampling: int = 1) -> WorkspaceDisc:
        """Map a disc found in the frame subsampled by `subsampling`: centre and radius."""
        return self.discs_to_workspace([disc], subsampling)[0]

    def discs_to_workspace(self, discs: Sequence[Disc], subsampling: int = 1) -> tuple[WorkspaceDisc, ...]:
        """Map many at once. The rim is mapped and a circle fitted to it: a circle's image has another centre."""
        if not discs:
            return ()
        circle = np.array([(disc.x_px, disc.y_px, disc.radius_px) for disc in discs])
        rim = circle[:, None, :2] + circle[:, 2, None, None] * directions(_RIM_POINTS)
        mapped = self.to_workspace(to_full_px(rim, subsampling))
        weights = np.ones(mapped.shape[:2])
        fitted, _ = fit_circles(mapped, weights, fit_circles_algebraic(mapped, weights))
        return tuple(WorkspaceDisc(float(x), float(y), float(radius)) for x, y, radius in fitted)


def calibrate(
    points_px: NDArray[np.float64],
    points_m: NDArray[np.float64],
    centre_px: tuple[float, float] = (639.5, 511.5),
) -> Calibration:
    """Fit homography and radial distortion to pairs of a pixel (K, 2) and a workspace point (K, 2) in metres.

    Least squares of the distances in the image, by Levenberg and Marquardt's method from the linear solution without
    distortion (Zhang 2000, section 3, for a single plane). `centre_px` is the principal point: the middle of the
    frame, which one view of a plane cannot tell from tilt. Raises CalibrationError for fewer than 6 pairs, values
    that are not finite, and points that lie on one line (or all but one or two of them do).
    """
    points_px, points_m = _checked(points_px, points_m)
    centre = np.array(centre_px)
    scale = float(norm(points_px - centre, axis=1).max()) or 1.0
    image = (points_px - centre) / scale
    unit = float(np.abs(points_m).max()) or 1.0
    plane = points_m / unit
    parameters = np.append(_linear_homography(plane, image), 0.0)
    kernels.calibration.refine(parameters, as_values(plane), as_values(image))
    homography = np.append(parameters[:8], 1.0).reshape(3, 3) * np.array([1 / unit, 1 / unit, 1.0])
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in homography)
    projection = PlaneProjection(
        homography=(a, b, c),
        radial_distortion=float(parameters[8]),
        centre_px=(float(centre[0]), float(centre[1])),
        scale_px=scale,
    )
    return Calibration(
        projection=projection,
        rms_px=_rms(projection.to_pixels(points_m) - points_px),
        rms_m=_rms(projection.to_workspace(points_px) - points_m),
    )


def _checked(
    points_px: NDArray[np.float64], points_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points_px = np.asarray(points_px, dtype=np.float64)
    points_m = np.asarray(points_m, dtype=np.float64)
    if points_px.ndim != 2 or points_px.shape[1] != 2 or points_px.shape != points_m.shape:
        raise CalibrationError(
            f"calibration pairs need equal shapes (K, 2), got pixels {points_px.shape} and metres {points_m.shape}"
        )
    if len(points_px) < _MIN_PAIRS:
        raise CalibrationError(f"calibration needs at least {_MIN_PAIRS} pairs, got {len(points_px)}")
    if not (np.isfinite(points_px).all() and np.isfinite(points_m).all()):
        raise CalibrationError("calibration pairs must be finite")
    for name, points in (("pixels", points_px), ("workspace points", points_m)):
        spread, _ = singular_values(points - points.mean(axis=0))
        if spread[1] <= 1e-6 * spread[0]:
            raise CalibrationError(f"the {len(points)} {name} of the calibration lie on one line")
    return points_px, points_m


def _linear_homography(plane: NDArray[np.float64], image: NDArray[np.float64]) -> NDArray[np.float64]:
    """The eight leading entries of the homography by the direct linear transform, the last being 1."""
    x, y, ones, zeros = plane[:, 0], plane[:, 1], np.ones(len(plane)), np.zeros(len(plane))
    u, v = image[:, 0], image[:, 1]
    rows_u = np.stack([x, y, ones, zeros, zeros, zeros, -u * x, -u * y, -u], axis=1)
    rows_v = np.stack([zeros, zeros, zeros, x, y, ones, -v * x, -v * y, -v], axis=1)
    singular, basis = singular_values(np.concatenate([rows_u, rows_v]))
    if singular[7] <= 1e-6 * singular[0] or abs(basis[8, 8]) < 1e-9:
        raise CalibrationError(
            f"the {len(plane)} calibration pairs do not fix the map: spread the points over the workspace"
        )
    return np.asarray(basis[:8, 8] / basis[8, 8])


def _rms(difference: NDArray[np.float64]) -> float:
    return float(np.sqrt((difference * difference).sum(axis=1).mean()))
