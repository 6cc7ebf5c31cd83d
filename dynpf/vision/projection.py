"""How a camera sees a plane: a homography, then radial distortion about the principal point."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.portable import inverse

__all__ = ["PlaneProjection"]

Row = tuple[float, float, float]


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
        ideal = _mapped(np.array(self.homography), points_m[..., 0], points_m[..., 1])
        stretch = 1 + self.radial_distortion * (ideal * ideal).sum(axis=-1, keepdims=True)
        return np.asarray(np.array(self.centre_px) + self.scale_px * ideal * stretch)

    def to_workspace(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map pixels (..., 2) to points (..., 2) in metres.

        The distorted radius s = r (1 + k r^2) is inverted by Newton's method; with k < 0 it has a greatest value,
        and pixels beyond that are taken to be there.
        """
        x, y = (
            np.array((points_px[..., axis] - self.centre_px[axis]) / self.scale_px, dtype=np.float64, order="C")
            for axis in (0, 1)
        )
        kernels.calibration.undistort(x.reshape(-1), y.reshape(-1), self.radial_distortion)
        return _mapped(inverse(np.array(self.homography)), x, y)


def _mapped(homography: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in homography)
    return np.stack([u / w, v / w], axis=-1)
