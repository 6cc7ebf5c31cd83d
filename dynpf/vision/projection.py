"""How a camera sees a plane: a homography, then radial distortion about the principal point."""

import msgspec
import numpy as np
from numpy.typing import NDArray

__all__ = ["PlaneProjection"]

Row = tuple[float, float, float]

_NEWTON_STEPS = 12


class PlaneProjection(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Maps points of a plane (metres) to pixels and back.

    `homography` takes (x, y, 1) to homogeneous normalized image coordinates p; the pixel is
    centre_px + scale_px * p * (1 + radial_distortion * |p|^2). A pixel's centre has whole coordinates.
    """

    homography: tuple[Row, Row, Row]
    radial_distortion: float
    centre_px: tuple[float, float]
    scale_px: float

    def to_pixels(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points (..., 2) in metres to pixels (..., 2)."""
        ideal = _apply(np.array(self.homography), points_m)
        stretch = 1 + self.radial_distortion * (ideal**2).sum(axis=-1, keepdims=True)
        return np.asarray(np.array(self.centre_px) + self.scale_px * ideal * stretch)

    def to_workspace(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map pixels (..., 2) to points (..., 2) in metres.

        The distorted radius s = r (1 + k r^2) is inverted by Newton's method; with k < 0 it has a greatest value,
        and pixels beyond that are taken to be there.
        """
        distorted = (points_px - np.array(self.centre_px)) / self.scale_px
        radius = np.sqrt((distorted**2).sum(axis=-1, keepdims=True))
        k = self.radial_distortion
        if k < 0:
            radius = np.minimum(radius, 0.999 * 2 / 3 / np.sqrt(-3 * k))
        ideal_radius = np.minimum(radius, 0.99 / np.sqrt(-3 * k)) if k < 0 else radius / (1 + k * radius**2)
        for _ in range(_NEWTON_STEPS):
            excess = ideal_radius * (1 + k * ideal_radius**2) - radius
            ideal_radius = ideal_radius - excess / (1 + 3 * k * ideal_radius**2)
        stretch = np.where(radius > 0, ideal_radius / np.maximum(radius, 1e-300), 1.0)
        return _apply(np.linalg.inv(np.array(self.homography)), distorted * stretch)


def _apply(homography: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points[..., 0], points[..., 1]
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in homography)
    return np.stack([u / w, v / w], axis=-1)
