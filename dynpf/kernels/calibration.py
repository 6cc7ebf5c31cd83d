"""A camera that looks at a plane: pixels back to the plane, and its parameters by Levenberg and Marquardt's method."""

import numpy as np

from dynpf.kernels import linear
from dynpf.kernels.compiler import device, kernel

__all__ = ["refine", "undistort"]

_solve = linear.solve

_NEWTON_STEPS = 12
_MOST_STEPS = 60
_SIZE = 9  # eight entries of the homography, the ninth being 1, and the distortion
_SMALLEST_STEP = 1e-14


@kernel
def undistort(x, y, distortion):
    """Replace distorted coordinates x and y (N,) by those that ``distortion`` k makes them from: s = r (1 + k r^2).

    By Newton's method; with k < 0 the distorted radius has a greatest value, and what lies beyond is taken to be there.
    """
    bent = distortion < 0.0
    farthest = 0.999 * 2 / 3 / np.sqrt(-3 * distortion) if bent else np.inf
    farthest_ideal = 0.99 / np.sqrt(-3 * distortion) if bent else np.inf
    for n in range(x.size):
        radius = min(np.sqrt(x[n] * x[n] + y[n] * y[n]), farthest)
        ideal = min(radius, farthest_ideal) if bent else radius / (1 + distortion * (radius * radius))
        for _ in range(_NEWTON_STEPS):
            square = distortion * (ideal * ideal)
            ideal = ideal - (ideal * (1 + square) - radius) / (1 + 3 * square)
        stretch = ideal / radius if radius > 0.0 else 1.0
        x[n] *= stretch
        y[n] *= stretch


@kernel
def refine(parameters, plane, image):
    """Move ``parameters`` (9,) to where the squared distances of ``plane``'s points (K, 2) to ``image`` are least.

    The parameters are eight entries of the homography by rows, the ninth being 1, and the radial distortion.
    """
    normal, step = np.empty((1, _SIZE, _SIZE)), np.empty((1, _SIZE, 1))
    row_u, row_v, trial = np.empty(_SIZE), np.empty(_SIZE), np.empty(_SIZE)
    damping, cost = 1e-3, _cost(parameters, plane, image)
    for _ in range(_MOST_STEPS):
        _equations(parameters, plane, image, row_u, row_v, normal[0], step[0])
        for i in range(_SIZE):
            normal[0, i, i] += damping * (normal[0, i, i] + 1e-12)
        if _solve(normal, step) >= 0:
            break
        largest = 0.0
        for i in range(_SIZE):
            trial[i] = parameters[i] + step[0, i, 0]
            largest = max(largest, abs(step[0, i, 0]))
        trial_cost = _cost(trial, plane, image)
        if trial_cost <= cost:
            parameters[:] = trial
            cost, damping = trial_cost, damping * 0.1
        else:
            damping *= 10.0
        if largest < _SMALLEST_STEP:
            break


@device
def _ideal(parameters, x, y):
    """Return image coordinates without distortion, and the denominator."""
    w = parameters[6] * x + parameters[7] * y + 1.0
    u = (parameters[0] * x + parameters[1] * y + parameters[2]) / w
    v = (parameters[3] * x + parameters[4] * y + parameters[5]) / w
    return u, v, w


@device
def _cost(parameters, plane, image):
    """Return the sum of squared distances in the image."""
    cost = 0.0
    for n in range(len(plane)):
        u, v, _ = _ideal(parameters, plane[n, 0], plane[n, 1])
        stretch = 1.0 + parameters[8] * (u * u + v * v)
        error_u, error_v = u * stretch - image[n, 0], v * stretch - image[n, 1]
        cost += error_u * error_u + error_v * error_v
    return cost


@device
def _equations(parameters, plane, image, row_u, row_v, normal, right):
    """Fill the normal equations (9, 9) and (9, 1) of a step that lowers the cost; the rows (9,) are room for it."""
    normal[:, :] = 0.0
    right[:, :] = 0.0
    k = parameters[8]
    for n in range(len(plane)):
        x, y = plane[n, 0], plane[n, 1]
        u, v, w = _ideal(parameters, x, y)
        square = u * u + v * v
        stretch, cross = 1.0 + k * square, 2.0 * k * u * v
        along_u, along_v = stretch + 2.0 * k * u * u, stretch + 2.0 * k * v * v
        for i in range(_SIZE - 1):
            # Of u and v by the entry: (x, y, 1) each, and both by what is below the line.
            coordinate = (x if i % 3 == 0 else (y if i % 3 == 1 else 1.0)) / w
            du = coordinate if i < 3 else (-u * coordinate if i > 5 else 0.0)
            dv = coordinate if 3 <= i < 6 else (-v * coordinate if i > 5 else 0.0)
            row_u[i] = along_u * du + cross * dv
            row_v[i] = cross * du + along_v * dv
        row_u[8], row_v[8] = u * square, v * square
        error_u, error_v = u * stretch - image[n, 0], v * stretch - image[n, 1]
        for i in range(_SIZE):
            right[i, 0] -= row_u[i] * error_u + row_v[i] * error_v
            for j in range(_SIZE):
                normal[i, j] += row_u[i] * row_u[j] + row_v[i] * row_v[j]
