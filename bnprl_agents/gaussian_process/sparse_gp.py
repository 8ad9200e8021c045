"""Sparse online Gaussian process (Csato and Opper 2002): one point at a time, within a budget.

The posterior of the prior N(0, k) is kept as mean k(x)' alpha and covariance
k(x, z) + k(x)' C k(z), k(x) being the kernel between x and m basis points. P = K^-1 tells how new
a point is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.kernels import RadialKernel, check_positive, radial

TOLERANCE_FLOOR = 1e-8
"""Least novelty of a basis point, as a share of the prior variance. Below, K is singular to
rounding: with a tolerance of 1e-12 the recursion for P loses every digit."""
UNLIMITED_FLOOR = 1e-9
"""The same without a budget, where nothing is removed and exactness is wanted."""
DRIFT = 1e-8
"""Largest residual of K P k = k, as a share of the prior variance, before P is computed anew."""


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
    """Return a basis without points, or an array of such along leading axes."""
    return Basis(
        points=np.zeros((*leading, capacity, dimensions)),
        weights=np.zeros((*leading, capacity)),
        covariance=np.zeros((*leading, capacity, capacity)),
        precision=np.zeros((*leading, capacity, capacity)),
        kernel=np.zeros((*leading, capacity, capacity)),
        size=np.zeros((*leading, 1), dtype=np.int64),
    )


class SparseGP:
    """A Gaussian process that learns online and keeps at most `budget` basis points.

    A step costs O(m^2) and the memory is O(budget^2), whatever the number of measurements. Without
    a budget and with a tolerance of 0 it is the exact process, as long as every point's novelty
    beta is above the floor; a point below it is projected onto the basis, as if the prior
    covariance there were smaller by beta.

    Rounding: C and P are symmetric to the last bit, because one triangle is computed and copied. A
    point joins only where it and every basis point stay as novel as the tolerance, which bounds
    the condition of K. Before it does, e = P k is refined by its residual, and P is computed anew
    from a Cholesky factor of K where that residual shows that it has drifted.

    Paper: Csato and Opper (2002), Sparse on-line Gaussian processes, Neural Computation 14;
    dissertation, section 3.7.2, with the corrected step (3.13).

    Args:
        kernel: of the prior, whose mean is 0.
        noise: variance of the measurements.
        budget: largest number of basis points; None: no limit.
        tolerance: novelty, as a share of the prior variance, above which a point joins the
            basis; at least `TOLERANCE_FLOOR` is used.
        forgetting: factor of C before each measurement: the posterior variance goes back towards
            the prior's, so that newer measurements weigh more; 1: none.

    Raises:
        ValueError: the noise is not positive, the budget is below 1, or the tolerance is not in
            [0, 1), or the forgetting not in (0, 1].
    """

    def __init__(
        self,
        kernel: RadialKernel,
        noise: float,
        budget: int | None = None,
        tolerance: float = 0.0,
        forgetting: float = 1.0,
    ) -> None:
        check_positive("noise", noise)
        check_forgetting(forgetting)
        check_sparsity(budget, tolerance)
        self.kernel = kernel
        self.noise = float(noise)
        self.budget = budget
        self.forgetting = float(forgetting)
        self.tolerance = max(
            float(tolerance), UNLIMITED_FLOOR if budget is None else TOLERANCE_FLOOR
        )
        capacity = 64 if budget is None else budget + 1
        self.basis = empty_basis(capacity, len(kernel.bandwidth))

    def __len__(self) -> int:
        return int(self.basis.size[0])

    @property
    def points(self) -> FloatArray:
        """The basis points (m, D)."""
        points: FloatArray = self.basis.points[: len(self)] * np.array(self.kernel.bandwidth)
        return points

    @property
    def weights(self) -> FloatArray:
        """Alpha (m,)."""
        return self.basis.weights[: len(self)]

    @property
    def covariance(self) -> FloatArray:
        """C (m, m), negative semidefinite."""
        return self.basis.covariance[: len(self), : len(self)]

    @property
    def precision(self) -> FloatArray:
        """P (m, m), the inverse of the kernel matrix of the basis points."""
        return self.basis.precision[: len(self), : len(self)]

    def update(self, point: npt.ArrayLike, target: float) -> None:
        """Learn one measurement.

        Args:
            point: (D,).
            target: what was measured there.

        Raises:
            ValueError: the point has another shape, or something is not finite.
        """
        x = self._scaled(point)[0]
        if not np.isfinite(target):
            raise ValueError(f"target: {target}, must be finite")
        if self.budget is None and len(self) == len(self.basis.points):
            self._grow()
        budget = len(self.basis.points) if self.budget is None else self.budget
        update(
            self.basis,
            x,
            float(target),
            self.kernel.amplitude,
            self.noise,
            self.tolerance,
            budget,
            self.forgetting,
        )

    def predict(self, points: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return mean (n,) and variance (n,), without the noise, at points (n, D); (3.6), (3.7).

        Raises:
            ValueError: the points have another shape, or one is not finite.
        """
        mean, variance = predict(self.basis, self._scaled(points), self.kernel.amplitude)
        return mean, variance

    def _scaled(self, points: npt.ArrayLike) -> FloatArray:
        array = np.atleast_2d(np.asarray(points, dtype=np.float64))
        if array.ndim != 2 or array.shape[1] != len(self.kernel.bandwidth):
            raise ValueError(
                f"points: shape {np.shape(points)}, must be (n, {len(self.kernel.bandwidth)})"
            )
        if not np.isfinite(array).all():
            raise ValueError("points: must be finite")
        return self.kernel.scaled(array)

    def _grow(self) -> None:
        """Double the capacity."""
        old, m = self.basis, len(self)
        self.basis = empty_basis(2 * m, old.points.shape[1])
        self.basis.points[:m], self.basis.weights[:m] = old.points, old.weights
        self.basis.covariance[:m, :m] = old.covariance
        self.basis.precision[:m, :m] = old.precision
        self.basis.kernel[:m, :m] = old.kernel
        self.basis.size[:] = old.size


def check_sparsity(budget: int | None, tolerance: float) -> None:
    """Check a budget and a tolerance.

    Raises:
        ValueError: the budget is below 1, or the tolerance is not in [0, 1).
    """
    if budget is not None and budget < 1:
        raise ValueError(f"budget: {budget}, must be at least 1")
    if not 0.0 <= tolerance < 1.0:
        raise ValueError(f"tolerance: {tolerance}, must lie in [0, 1)")


def check_forgetting(forgetting: float) -> None:
    """Check a factor of forgetting.

    Raises:
        ValueError: it is not in (0, 1].
    """
    if not 0.0 < forgetting <= 1.0:
        raise ValueError(f"forgetting: {forgetting}, must lie in (0, 1]")


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
    return max(amplitude + _dot(k, ck), 0.0)


@njit(cache=True)
def mean_and_variance(basis, x, amplitude):  # type: ignore[no-untyped-def]
    """Return both at a point."""
    k = covariances(basis, x, amplitude)
    return _dot(k, basis.weights), variance(basis, k, _times(basis.covariance, k), amplitude)


@njit(cache=True)
def predict(basis, points, amplitude):  # type: ignore[no-untyped-def]
    """Return mean (n,) and variance (n,) at points (n, D)."""
    means, variances = np.empty(points.shape[0]), np.empty(points.shape[0])
    for i in range(points.shape[0]):
        means[i], variances[i] = mean_and_variance(basis, points[i], amplitude)
    return means, variances


@njit(cache=True)
def update(basis, x, y, amplitude, noise, tolerance, budget, forgetting):  # type: ignore[no-untyped-def]
    """Learn one measurement y at x in place; return its error y - m(x) before.

    Needs capacity for one more basis point.
    """
    if forgetting < 1.0:
        m = basis.size[0]
        basis.covariance[:m, :m] *= forgetting
    k = covariances(basis, x, amplitude)
    ck, projection = _times(basis.covariance, k), _times(basis.precision, k)
    spread = variance(basis, k, ck, amplitude)
    novelty = amplitude - _dot(k, projection)  # beta, (3.8)
    error = y - _dot(k, basis.weights)
    q = error / (noise + spread)
    r = -1.0 / (noise + spread)
    if novelty > tolerance * amplitude:
        projection = _refined(basis, k, projection)
        novelty = amplitude - _dot(k, projection)
    if _is_new(basis, projection, novelty, tolerance * amplitude):
        _extend(basis, x, ck, q, r)
        _extend_precision(basis, k, projection, novelty, amplitude)
        if basis.size[0] > budget:
            remove(basis, _least_valuable(basis))
    else:
        eta = 1.0 / (1.0 + min(max(novelty, 0.0), spread) * r)
        s = ck + projection
        for i in range(s.size):
            basis.weights[i] += q * eta * s[i]
        _add_outer(basis.covariance, s, r * eta)
    return error


@njit(cache=True)
def _refined(basis, k, projection):  # type: ignore[no-untyped-def]
    """Return e = K^-1 k after a step of iterative refinement; P is renewed if it has drifted."""
    residual = k - _times(basis.kernel, projection)
    if k.size and np.abs(residual).max() > DRIFT * basis.kernel[0, 0]:
        refresh(basis)
        projection = _times(basis.precision, k)
        residual = k - _times(basis.kernel, projection)
    return projection + _times(basis.precision, residual)


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
    s = np.empty(m + 1)
    s[:m], s[m] = ck, 1.0
    basis.points[m] = x
    basis.weights[m] = 0.0
    basis.covariance[m, : m + 1], basis.covariance[: m + 1, m] = 0.0, 0.0
    for i in range(m + 1):
        basis.weights[i] += q * s[i]
    _add_outer(basis.covariance, s, r)
    basis.size[0] = m + 1


@njit(cache=True)
def _extend_precision(basis, k, projection, novelty, amplitude):  # type: ignore[no-untyped-def]
    """P = pad(P) + [e, -1] [e, -1]' / beta, e = P k; K gets its row and column."""
    m = projection.size
    e = np.empty(m + 1)
    e[:m], e[m] = projection, -1.0
    basis.precision[m, : m + 1], basis.precision[: m + 1, m] = 0.0, 0.0
    _add_outer(basis.precision, e, 1.0 / novelty)
    basis.kernel[m, :m], basis.kernel[:m, m], basis.kernel[m, m] = k, k, amplitude


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
    m = basis.size[0]
    alpha, c, p = basis.weights, basis.covariance, basis.precision
    p_i, c_i = p[:m, i] / p[i, i], c[:m, i].copy()
    alpha_i, c_ii, p_ii = alpha[i], c[i, i], p[i, i]
    for j in range(m):
        alpha[j] -= alpha_i * p_i[j]
        for n in range(j + 1):
            c[j, n] += c_ii * p_i[j] * p_i[n] - (p_i[j] * c_i[n] + c_i[j] * p_i[n])
            p[j, n] -= p_ii * p_i[j] * p_i[n]
            c[n, j], p[n, j] = c[j, n], p[j, n]
    last = m - 1
    basis.points[i], alpha[i] = basis.points[last], alpha[last]
    for matrix in (basis.kernel, c, p):
        matrix[i, :m] = matrix[last, :m]
        matrix[:m, i] = matrix[:m, last]
        matrix[i, i] = matrix[last, last]
    basis.size[0] = last


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
    product = np.dot(inverse.T, inverse)
    for i in range(m):
        for j in range(i + 1):
            basis.precision[i, j] = basis.precision[j, i] = product[i, j]


@njit(cache=True)
def _times(matrix, vector):  # type: ignore[no-untyped-def]
    """Return the product of the leading block of a symmetric matrix with a vector (m,)."""
    m = vector.size
    product = np.zeros(m)
    for i in range(m):
        total = 0.0
        for j in range(m):
            total += matrix[i, j] * vector[j]
        product[i] = total
    return product


@njit(cache=True)
def _dot(vector, padded):  # type: ignore[no-untyped-def]
    """Return the inner product of a vector (m,) with the beginning of another."""
    total = 0.0
    for i in range(vector.size):
        total += vector[i] * padded[i]
    return total


@njit(cache=True)
def _add_outer(matrix, s, factor):  # type: ignore[no-untyped-def]
    """Add factor s s' to the leading block of a symmetric matrix, which stays symmetric."""
    for i in range(s.size):
        row = factor * s[i]
        for j in range(i + 1):
            matrix[i, j] += row * s[j]
            matrix[j, i] = matrix[i, j]
