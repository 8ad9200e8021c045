"""Learning one measurement within a budget of basis points (Csato and Opper 2002).

The notation is that of `basis`. A point whose novelty is large joins the basis; any other is
projected onto it; over the budget the least valuable basis point goes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.gaussian_process.basis import covariances, dot, times, variance

DRIFT = 1e-8
"""Largest residual of K P k = k, as a share of the prior variance, before P is computed anew."""


@njit(cache=True)
def update(basis, x, y, amplitude, noise, tolerance, budget, forgetting):  # type: ignore[no-untyped-def]
    """Learn one measurement y at x in place; return its error y - m(x) before.

    Needs capacity for one more basis point.
    """
    if forgetting < 1.0:
        _forget(basis, forgetting)
    k = covariances(basis, x, amplitude)
    ck, projection = times(basis.covariance, k), times(basis.precision, k)
    spread = variance(basis, k, ck, amplitude)
    novelty = amplitude - dot(k, projection)  # beta, (3.8)
    error = y - dot(k, basis.weights)
    q = error / (noise + spread)
    r = -1.0 / (noise + spread)
    if novelty > tolerance * amplitude:
        projection = _refined(basis, k, projection)
        novelty = amplitude - dot(k, projection)
    if _is_new(basis, projection, novelty, tolerance * amplitude):
        _extend(basis, x, ck, q, r)
        _extend_precision(basis, k, projection, novelty, amplitude)
        if basis.size[0] > budget:
            remove(basis, _least_valuable(basis))
    else:
        eta = 1.0 / (1.0 + min(max(novelty, 0.0), spread) * r)
        _add(ck, projection)
        _step(basis, ck, q * eta, r * eta)
    return error


@njit(cache=True)
def _forget(basis, factor):  # type: ignore[no-untyped-def]
    """C *= factor: every posterior variance goes back towards the prior's."""
    for i in range(basis.size[0]):
        for j in range(basis.size[0]):
            basis.covariance[i, j] *= factor


@njit(cache=True)
def _step(basis, s, q, r):  # type: ignore[no-untyped-def]
    """Alpha += q s, C += r s s'."""
    for i in range(s.size):
        basis.weights[i] += q * s[i]
    _add_outer(basis.covariance, s, r)


@njit(cache=True)
def _refined(basis, k, projection):  # type: ignore[no-untyped-def]
    """Return e = K^-1 k after a step of iterative refinement; P is renewed if it has drifted."""
    residual = _residual(basis, k, projection)
    if k.size and np.abs(residual).max() > DRIFT * basis.kernel[0, 0]:
        refresh(basis)
        projection = times(basis.precision, k)
        residual = _residual(basis, k, projection)
    _add(projection, times(basis.precision, residual))
    return projection


@njit(cache=True)
def _residual(basis, k, projection):  # type: ignore[no-untyped-def]
    """Return k - K e."""
    residual = times(basis.kernel, projection)
    for i in range(k.size):
        residual[i] = k[i] - residual[i]
    return residual


@njit(cache=True)
def _is_new(basis, projection, novelty, tolerance):  # type: ignore[no-untyped-def]
    """Whether a point is new, and every basis point, whose novelty is 1 / P_ii, stays so."""
    if novelty <= tolerance:
        return False
    for i in range(projection.size):
        if basis.precision[i, i] + projection[i] ** 2 / novelty >= 1.0 / tolerance:
            return False
    return True


@njit(cache=True)
def _extend(basis, x, ck, q, r):  # type: ignore[no-untyped-def]
    """Add a basis point: s = [Ck, 1], alpha = [alpha, 0] + q s, C = pad(C) + r s s'."""
    m = ck.size
    for d in range(x.size):
        basis.points[m, d] = x[d]
    basis.weights[m] = 0.0
    _pad(basis.covariance, m)
    _step(basis, _appended(ck, 1.0), q, r)
    basis.size[0] = m + 1


@njit(cache=True)
def _extend_precision(basis, k, projection, novelty, amplitude):  # type: ignore[no-untyped-def]
    """P = pad(P) + [e, -1] [e, -1]' / beta, e = P k; K gets its row and column."""
    m = k.size
    _pad(basis.precision, m)
    _add_outer(basis.precision, _appended(projection, -1.0), 1.0 / novelty)
    for i in range(m):
        basis.kernel[m, i] = basis.kernel[i, m] = k[i]
    basis.kernel[m, m] = amplitude


@njit(cache=True)
def _pad(matrix, m):  # type: ignore[no-untyped-def]
    """Set row and column m to 0."""
    for i in range(m + 1):
        matrix[m, i] = matrix[i, m] = 0.0


@njit(cache=True)
def _appended(vector, last):  # type: ignore[no-untyped-def]
    """Return [vector, last]."""
    longer = np.empty(vector.size + 1)
    for i in range(vector.size):
        longer[i] = vector[i]
    longer[vector.size] = last
    return longer


@njit(cache=True)
def _add(vector, other):  # type: ignore[no-untyped-def]
    """Add another vector in place."""
    for i in range(vector.size):
        vector[i] += other[i]


@njit(cache=True)
def _least_valuable(basis):  # type: ignore[no-untyped-def]
    """Return the basis point with the smallest |alpha_i| / P_ii."""
    best, least = 0, np.inf
    for i in range(basis.size[0]):
        score = abs(basis.weights[i]) / basis.precision[i, i]
        if score < least:
            best, least = i, score
    return best


@njit(cache=True)
def remove(basis, i):  # type: ignore[no-untyped-def]
    """Remove basis point i by the best projection onto the others; the last one takes its place.

    alpha -= alpha_i P_i / p; C += c_i P_i P_i' / p^2 - (P_i C_i' + C_i P_i') / p;
    P -= P_i P_i' / p; p = P_ii.
    """
    m, last = basis.size[0], basis.size[0] - 1
    alpha, c, p = basis.weights, basis.covariance, basis.precision
    p_i, c_i = np.empty(m), np.empty(m)
    for j in range(m):
        p_i[j], c_i[j] = p[j, i] / p[i, i], c[j, i]
    alpha_i, c_ii, p_ii = alpha[i], c[i, i], p[i, i]
    for j in range(m):
        alpha[j] -= alpha_i * p_i[j]
        for n in range(j + 1):
            c[j, n] += c_ii * p_i[j] * p_i[n] - (p_i[j] * c_i[n] + c_i[j] * p_i[n])
            p[j, n] -= p_ii * p_i[j] * p_i[n]
            c[n, j], p[n, j] = c[j, n], p[j, n]
    for d in range(basis.points.shape[1]):
        basis.points[i, d] = basis.points[last, d]
    alpha[i] = alpha[last]
    for matrix in (basis.kernel, c, p):
        _move(matrix, last, i)
    basis.size[0] = last


@njit(cache=True)
def _move(matrix, last, i):  # type: ignore[no-untyped-def]
    """Let the last row and column of a symmetric matrix take the place of row and column i."""
    for j in range(last):
        matrix[i, j] = matrix[j, i] = matrix[last, j]
    matrix[i, i] = matrix[last, last]


@njit(cache=True)
def refresh(basis):  # type: ignore[no-untyped-def]
    """Compute P anew as L^-T L^-1 from the Cholesky factor L of K."""
    m = basis.size[0]
    factor, inverse = np.zeros((m, m)), np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = basis.kernel[i, j]
            for n in range(j):
                total -= factor[i, n] * factor[j, n]
            factor[i, j] = np.sqrt(total) if i == j else total / factor[j, j]
        inverse[i, i] = 1.0 / factor[i, i]
        for n in range(i):
            for j in range(n + 1):
                inverse[i, j] -= factor[i, n] * inverse[n, j] / factor[i, i]
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for n in range(i, m):
                total += inverse[n, i] * inverse[n, j]
            basis.precision[i, j] = basis.precision[j, i] = total


@njit(cache=True)
def _add_outer(matrix, s, factor):  # type: ignore[no-untyped-def]
    """Add factor s s' to the leading block of a symmetric matrix, which stays symmetric.

    Row by row, and entries (i, j) and (j, i) are rounded alike.
    """
    scaled = factor * s
    for i in range(s.size):
        for j in range(i + 1):
            matrix[i, j] += scaled[i] * s[j]
        for j in range(i + 1, s.size):
            matrix[i, j] += scaled[j] * s[i]
