"""The Gaussian that readings leave of the motion's noise, particle by particle."""

import numpy as np

from dynpf.types import FloatArray, Floats

__all__ = ["draw", "information"]


def information(
    root: FloatArray, jacobian: FloatArray, innovation: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A^T R^-1 A (D, D, N) and A^T R^-1 v (D, N), A = H L, and log N(v; 0, R) (N,).

    L (D, D, N), H (M, D, N), v (M, N) and R (M, M).
    """
    slope = np.einsum("mdn,den->men", jacobian, root)
    inverse = np.linalg.inv(noise)
    squared = np.einsum("mn,ml,ln->n", innovation, inverse, innovation)
    log_density = -0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * noise)[1])
    return (
        np.einsum("man,ml,lbn->abn", slope, inverse, slope),
        np.einsum("man,ml,ln->an", slope, inverse, innovation),
        log_density,
    )


def draw(precision: FloatArray, pull: FloatArray, standard: Floats) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return draws (D, N) from N(P^-1 b, P^-1), b^T P^-1 b (N,) and 0.5 log det P (N,).

    P (D, D, N), b (D, N) and standard normal numbers (D, N); the draw is P^-1 b plus L^-T times those, L L^T = P.
    """
    drawn, gain, log_determinant = np.empty(pull.shape), np.empty(pull.shape[1]), np.empty(pull.shape[1])
    for k in range(pull.shape[1]):
        lower = np.linalg.cholesky(precision[..., k])
        mean = np.linalg.solve(precision[..., k], pull[:, k])
        drawn[:, k] = mean + np.linalg.solve(lower.T, standard[:, k])
        gain[k] = pull[:, k] @ mean
        log_determinant[k] = np.sum(np.log(np.diag(lower)))
    return drawn, gain, log_determinant
