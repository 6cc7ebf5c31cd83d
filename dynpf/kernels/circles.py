"""Circles through points, many at a time: Taubin's algebraic fit, and the geometric one with all of its steps.

Sums are taken point after point, so that a circle depends on its own points alone.
"""

import numpy as np

from dynpf.kernels import linear
from dynpf.kernels.compiler import device, kernel

__all__ = ["fit_algebraic", "fit_geometric"]

_eigen, _solve = linear.eigen, linear.solve

_MOST_STEPS = 30
_CONVERGED = 1e-8  # last step relative to the radius; the error is of the order of its square
_LEAST_WEIGHT, _LEAST_DISTANCE, _LEAST_SQUARE = 1e-12, 1e-12, 1e-24
_FLAT = 1e-9  # a curvature below it is that of a straight line


@kernel
def fit_algebraic(points, weights, circles):
    """Fill ``circles`` (D, 3: x, y, radius) with Taubin's fits to ``points`` by ``weights`` (D, K).

    ``points`` are (D, K, 2), or (1, K, 2) when all circles choose from the same. The smallest eigenvector of the
    moments of (z, x, y), z = x^2 + y^2 centred and scaled, is the circle.
    """
    count, size = weights.shape
    moments, vectors = np.zeros((count, 3, 3)), np.empty((count, 3, 3))
    scales, squares = np.empty(count), np.empty(count)
    for d in range(count):
        own, weight, moment = points[d if len(points) > 1 else 0], weights[d], moments[d]
        total, mean_x, mean_y = 0.0, 0.0, 0.0
        for k in range(size):
            total += weight[k]
            mean_x += weight[k] * own[k, 0]
            mean_y += weight[k] * own[k, 1]
        total = max(total, _LEAST_WEIGHT)
        mean_x, mean_y = mean_x / total, mean_y / total
        mean_z = 0.0
        for k in range(size):
            x, y = own[k, 0] - mean_x, own[k, 1] - mean_y
            mean_z += weight[k] * (x * x + y * y)
        mean_z = max(mean_z / total, _LEAST_SQUARE)
        scale = 2.0 * np.sqrt(mean_z)
        for k in range(size):
            x, y, share = own[k, 0] - mean_x, own[k, 1] - mean_y, weight[k] / total
            z = (x * x + y * y - mean_z) / scale
            moment[0, 0] += share * z * z
            moment[0, 1] += share * z * x
            moment[0, 2] += share * z * y
            moment[1, 1] += share * x * x
            moment[1, 2] += share * x * y
            moment[2, 2] += share * y * y
        moment[1, 0], moment[2, 0], moment[2, 1] = moment[0, 1], moment[0, 2], moment[1, 2]
        circles[d, 0], circles[d, 1] = mean_x, mean_y
        scales[d], squares[d] = scale, mean_z
    _eigen(moments, vectors)
    for d in range(count):
        smallest = 0
        for i in range(1, 3):
            if moments[d, i, i] < moments[d, smallest, smallest]:
                smallest = i
        z, x, y = vectors[d, 0, smallest], vectors[d, 1, smallest], vectors[d, 2, smallest]
        lever = scales[d] / (2.0 * (_FLAT if abs(z) < _FLAT else z))
        offset_x, offset_y = -x * lever, -y * lever
        circles[d, 0] += offset_x
        circles[d, 1] += offset_y
        circles[d, 2] = np.sqrt(offset_x * offset_x + offset_y * offset_y + squares[d])


@kernel
def fit_geometric(points, weights, circles, residuals):
    """Move ``circles`` (D, 3) to where sum_k w_k (||p_k - b|| - rho)^2 is least; fill ``residuals`` (D,) with the rms.

    ``points`` and ``weights`` as for ``fit_algebraic``. Levenberg's method; each circle takes the steps that it needs.
    """
    normal, step, trial = np.empty((1, 3, 3)), np.empty((1, 3, 1)), np.empty(3)
    for d in range(len(circles)):
        own, weight, circle = points[d if len(points) > 1 else 0], weights[d], circles[d]
        total = 0.0
        for k in range(weight.size):
            total += weight[k]
        total = max(total, _LEAST_WEIGHT)
        damping, cost = 1e-6, _cost(own, weight, circle)
        for _ in range(_MOST_STEPS):
            _equations(own, weight, circle, normal[0], step[0])
            for i in range(3):
                normal[0, i, i] += damping * total + 1e-12
            _solve(normal, step)
            largest = 0.0
            for i in range(3):
                trial[i] = circle[i] + step[0, i, 0]
                largest = max(largest, abs(step[0, i, 0]))
            trial_cost = _cost(own, weight, trial)
            if trial_cost <= cost:
                circle[:] = trial
                cost, damping = trial_cost, damping * 0.1
            else:
                damping *= 10.0
            if largest <= _CONVERGED * (1.0 + abs(circle[2])):
                break
        residuals[d] = np.sqrt(cost / total)


@device
def _cost(points, weights, circle):
    """Return the weighted sum of squared distances to the rim."""
    cost = 0.0
    for k in range(weights.size):
        x, y = points[k, 0] - circle[0], points[k, 1] - circle[1]
        error = max(np.sqrt(x * x + y * y), _LEAST_DISTANCE) - circle[2]
        cost += weights[k] * (error * error)
    return cost


@device
def _equations(points, weights, circle, normal, right):
    """Fill the normal equations (3, 3) and (3, 1) of a step towards the rim."""
    normal[:, :] = 0.0
    right[:, :] = 0.0
    for k in range(weights.size):
        x, y, weight = points[k, 0] - circle[0], points[k, 1] - circle[1], weights[k]
        distance = max(np.sqrt(x * x + y * y), _LEAST_DISTANCE)
        x, y, error = x / distance, y / distance, distance - circle[2]
        normal[0, 0] += weight * x * x
        normal[0, 1] += weight * x * y
        normal[0, 2] += weight * x
        normal[1, 1] += weight * y * y
        normal[1, 2] += weight * y
        normal[2, 2] += weight
        right[0, 0] += weight * x * error
        right[1, 0] += weight * y * error
        right[2, 0] += weight * error
    normal[1, 0], normal[2, 0], normal[2, 1] = normal[0, 1], normal[0, 2], normal[1, 2]
