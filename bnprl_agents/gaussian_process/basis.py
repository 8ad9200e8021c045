"""The state of a sparse online Gaussian process, and what it predicts.

The posterior of the prior N(0, k) is kept as mean k(x)' alpha and covariance
k(x, z) + k(x)' C k(z), k(x) being the kernel between x and m basis points. P = K^-1 tells how new
a point is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.kernels import radial
from bnprl_agents.settings import check_entries


class Basis(NamedTuple):
    """The state of a process, in arrays whose size is the capacity M >= m.

    Attributes:
        points: (M, D) basis points, in units of the bandwidths.
        weights: (M,) alpha.
        covariance: (M, M) C.
        precision: (M, M) P, the inverse of K.
        kernel: (M, M) K, the kernel matrix of the basis points.
        size: (1,) m.
    """

    points: FloatArray
    weights: FloatArray
    covariance: FloatArray
    precision: FloatArray
    kernel: FloatArray
    size: IntArray


def empty_basis(capacity: int, dimensions: int, *leading: int) -> Basis:
    """Return a basis without points, or an array of such along leading axes.

    Raises:
        ValueError: a table would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
    """
    check_entries("budget", *leading, capacity, max(capacity, dimensions))
    return Basis(
        points=np.zeros((*leading, capacity, dimensions)),
        weights=np.zeros((*leading, capacity)),
        covariance=np.zeros((*leading, capacity, capacity)),
        precision=np.zeros((*leading, capacity, capacity)),
        kernel=np.zeros((*leading, capacity, capacity)),
        size=np.zeros((*leading, 1), dtype=np.int64),
    )


@njit(cache=True)
def covariances(basis, x, amplitude):  # type: ignore[no-untyped-def]
    """Return the kernel (m,) between a point and the basis."""
    k = np.empty(basis.size[0])
    for i in range(k.size):
        k[i] = radial(x, basis.points[i], amplitude)
    return k


@njit(cache=True)
def mean(basis, x, amplitude):  # type: ignore[no-untyped-def]
    """Return the posterior mean k' alpha at a point; (3.6)."""
    total = 0.0
    for i in range(basis.size[0]):
        total += basis.weights[i] * radial(x, basis.points[i], amplitude)
    return total


@njit(cache=True)
def variance(basis, k, ck, amplitude):  # type: ignore[no-untyped-def]
    """Return the posterior variance k(x, x) + k' C k, at least 0; (3.7)."""
    return max(amplitude + dot(k, ck), 0.0)


@njit(cache=True)
def mean_and_variance(basis, x, amplitude):  # type: ignore[no-untyped-def]
    """Return both at a point."""
    k = covariances(basis, x, amplitude)
    return dot(k, basis.weights), variance(basis, k, times(basis.covariance, k), amplitude)


@njit(cache=True)
def predict(basis, points, amplitude):  # type: ignore[no-untyped-def]
    """Return mean (n,) and variance (n,) at points (n, D)."""
    means, variances = np.empty(points.shape[0]), np.empty(points.shape[0])
    for i in range(points.shape[0]):
        means[i], variances[i] = mean_and_variance(basis, points[i], amplitude)
    return means, variances


@njit(cache=True)
def times(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the product of the leading block of a symmetric matrix with a vector (m,).

    It is summed row by row, which a processor does several entries at a time, unlike one sum.
    """
    m = vector.size
    product = np.zeros(m)
    for i in range(m):
        for j in range(m):
            product[j] += vector[i] * matrix[i, j]
    return product


@njit(cache=True)
def dot(vector, padded):  # type: ignore[no-untyped-def]
    """Return the inner product of a vector (m,) with the beginning of another."""
    total = 0.0
    for i in range(vector.size):
        total += vector[i] * padded[i]
    return total
