"""Bandwidths, amplitude and noise of a Gaussian process by the evidence of the data."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from bnprl_agents.episodes import FloatArray
from bnprl_agents.gaussian_process.kernels import RadialKernel

RANGE = np.log(100.0)
"""Largest change of a hyper-parameter, in logarithms."""


def log_marginal_likelihood(
    kernel: RadialKernel, noise: float, x: npt.ArrayLike, y: npt.ArrayLike
) -> tuple[float, FloatArray]:
    """Return log p(y | x) and its gradient (D + 2,).

    The gradient is by the logarithms of the D bandwidths, of the amplitude and of the noise.

    Args:
        kernel: of the prior, whose mean is 0.
        noise: variance of the measurements, positive.
        x: (n, D).
        y: (n,).
    """
    points, target = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    k = kernel(points, points)
    factor = cho_factor(k + noise * np.eye(len(target)), lower=True)
    alpha = cho_solve(factor, target)
    half_log_determinant = np.log(np.diag(factor[0])).sum()
    value = -0.5 * target @ alpha - half_log_determinant - 0.5 * len(target) * np.log(2.0 * np.pi)
    slope = 0.5 * (np.outer(alpha, alpha) - cho_solve(factor, np.eye(len(target))))
    squares = (points[:, None] - points[None]) ** 2 / np.square(kernel.bandwidth)
    by_bandwidth = np.einsum("ij,ij,ijd->d", slope, k, squares)
    by_scale = ((slope * k).sum(), noise * np.trace(slope))
    return float(value), np.array([*by_bandwidth, *by_scale])


def select_hyperparameters(
    kernel: RadialKernel,
    noise: float,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    groups: npt.ArrayLike | None = None,
) -> tuple[RadialKernel, float]:
    """Return the kernel and the noise of largest marginal likelihood near the given ones.

    Args:
        kernel: where the search (L-BFGS-B over logarithms) begins.
        noise: likewise.
        x: (n, D).
        y: (n,).
        groups: (n,) which of several independent processes, alike in their hyper-parameters, each
            measurement is of; None: one process.
    """
    points, target = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    labels = np.zeros(len(target)) if groups is None else np.asarray(groups)
    members = [labels == label for label in np.unique(labels)]

    def parameters(logs: FloatArray) -> tuple[RadialKernel, float]:
        *bandwidth, amplitude, variance = np.exp(logs).tolist()
        return RadialKernel(tuple(bandwidth), amplitude), variance

    def loss(logs: FloatArray) -> tuple[float, FloatArray]:
        parts = [
            log_marginal_likelihood(*parameters(logs), points[own], target[own]) for own in members
        ]
        gradient: FloatArray = -np.sum([gradient for _, gradient in parts], axis=0)
        return -sum(value for value, _ in parts), gradient

    begin = np.log([*kernel.bandwidth, kernel.amplitude, noise])
    bounds = [(log - RANGE, log + RANGE) for log in begin.tolist()]
    found: Any = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds)
    return parameters(found.x)
