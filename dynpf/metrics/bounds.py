"""Posterior Cramer-Rao bounds: how small the error of any filter can be, given the noise.

For x_{k+1} = f(x_k) + eta_k and z_k = h(x_k) + nu_k with Gaussian noise of covariances Q and R, independent of each
other and over time. Expectations are means over samples of the true trajectories, at which the Jacobians F of f and H
of h are taken. An information matrix J bounds the covariance of the error: E{e e^T} >= J^-1 (PARTS eq. 3.34).

Q and R may differ from sample to sample, as noise does that goes by the heading; what the covariances themselves then
tell about the state is left out, as it is by the filters.
"""

from collections.abc import Sequence

import numpy as np

from dynpf.types import FloatArray, Floats

__all__ = ["covariance_bound", "measurement_information", "noiseless_information", "posterior_information", "rms_bound"]


def measurement_information(observations: FloatArray, noise: FloatArray) -> FloatArray:
    """Return H^T R^-1 H, shape (..., D, D), of Jacobians (..., M, D) and noise covariances (..., M, M) or (M, M).

    A row of zeros in H is a number that was not measured. Raises numpy.linalg.LinAlgError where R is singular.
    """
    return np.swapaxes(observations, -1, -2) @ np.linalg.solve(noise, observations)


def posterior_information(
    prior: FloatArray, transitions: FloatArray, process: FloatArray, gained: FloatArray
) -> FloatArray:
    """Return J_0 to J_T, shape (T + 1, D, D), by the recursion of Tichavsky, Muravchik and Nehorai (1998).

    J_{k+1} = D22 - D21 (J_k + D11)^-1 D12 with D11 = E{F^T Q^-1 F}, D12 = -E{F^T Q^-1} = D21^T and
    D22 = E{Q^-1} + E{H^T R^-1 H} (PARTS eq. 3.35). It is evaluated by its equal J_{k+1} = (G (J_k + V)^-1 G^T + W)^-1 +
    E{H^T R^-1 H} with W = E{Q^-1}^-1, G = -W D21 and V = E{(F - G)^T Q^-1 (F - G)}, where a small Q cancels no digits.
    When all samples have the same F and Q, then G = F, W = Q and V = 0, and Q may be singular or zero.

    ``prior`` (D, D) is J_0, positive definite. Entry k of the others is step k: ``transitions`` F at x_k, (T, S, D, D)
    over S samples; ``process`` Q, of that shape or (D, D); ``gained`` the information of the readings of x_{k+1},
    (T, S, D, D) from measurement_information, zero where there are none.

    Raises ValueError when samples differ in F or Q and a Q is singular: there is no bound of this form then.
    numpy.linalg.LinAlgError when the prior is singular, or F where Q is.
    """
    process = np.broadcast_to(process, transitions.shape)
    information = [np.asarray(prior, dtype=np.float64)]
    for step, (transition, noise, reading) in enumerate(zip(transitions, process, gained, strict=True)):
        if _all_equal(transition) and _all_equal(noise):
            mean, spread, among = transition[0], noise[0], np.zeros_like(noise[0])
        elif np.all(np.linalg.matrix_rank(noise, hermitian=True) == noise.shape[-1]):
            mean, spread, among = _averaged(transition, noise)
        else:
            raise ValueError(
                f"step {step}: the process noise is singular and the transitions differ between samples; give one "
                "trajectory at a time, or take noiseless_information where there is no process noise at all"
            )
        predicted = mean @ np.linalg.inv(information[-1] + among) @ mean.T + spread
        information.append(_symmetric(np.linalg.inv(predicted) + reading.mean(axis=0)))
    return np.stack(information)


def noiseless_information(prior: FloatArray, transitions: FloatArray, gained: FloatArray) -> FloatArray:
    """Return J_0 to J_T, shape (T + 1, ..., D, D), of a motion without noise (PARTS eq. 3.38).

    J_{k+1} = F^-T J_k F^-1 + H^T R^-1 H along each trajectory: ``transitions`` F at x_k and ``gained`` H^T R^-1 H at
    x_{k+1}, both (T, ..., D, D); ``prior`` J_0, (D, D). The bounds of several trajectories are averaged as
    covariances or as RMS, not as information. Raises numpy.linalg.LinAlgError where F is singular.
    """
    information = [np.array(np.broadcast_to(prior, transitions.shape[1:]), dtype=np.float64)]
    for transition, reading in zip(transitions, gained, strict=True):
        back = np.linalg.inv(transition)
        information.append(_symmetric(np.swapaxes(back, -1, -2) @ information[-1] @ back + reading))
    return np.stack(information)


def covariance_bound(information: FloatArray) -> FloatArray:
    """Return J^-1, shape (..., D, D); raises numpy.linalg.LinAlgError where J is singular: there is no bound."""
    return _symmetric(np.linalg.inv(information))


def rms_bound(information: FloatArray, rows: Sequence[int] = (0, 1)) -> FloatArray:
    """Return the least root mean square of the norm of the error in the given rows, shape (...) (PARTS eq. 3.41)."""
    variances = np.diagonal(covariance_bound(information), axis1=-2, axis2=-1)
    return np.asarray(np.sqrt(variances[..., list(rows)].sum(axis=-1)))


def _averaged(transition: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return G, W and V, each (D, D), of samples of F and Q, each (S, D, D)."""
    precision = np.linalg.inv(noise)
    spread = np.linalg.inv(precision.mean(axis=0))
    mean = spread @ (precision @ transition).mean(axis=0)
    apart = transition - mean
    return mean, spread, (np.swapaxes(apart, -1, -2) @ precision @ apart).mean(axis=0)


def _all_equal(matrices: FloatArray) -> bool:
    return bool((matrices == matrices[0]).all())


def _symmetric(matrices: Floats) -> FloatArray:
    return np.asarray(0.5 * (matrices + np.swapaxes(matrices, -1, -2)), dtype=np.float64)
