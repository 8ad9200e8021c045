"""Sparse online Gaussian process (Csato and Opper 2002): one point at a time, within a budget.

Its state and predictions are in `basis`, its step in `online_update`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bnprl_agents.episodes import FloatArray
from bnprl_agents.gaussian_process.basis import Basis, empty_basis, predict
from bnprl_agents.gaussian_process.kernels import RadialKernel, check_positive
from bnprl_agents.gaussian_process.online_update import update

TOLERANCE_FLOOR = 1e-8
"""Least novelty of a basis point, as a share of the prior variance. Below, K is singular to
rounding: with a tolerance of 1e-12 the recursion for P loses every digit."""
UNLIMITED_FLOOR = 1e-9
"""The same without a budget, where nothing is removed and exactness is wanted."""


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
        self.basis: Basis = empty_basis(capacity, len(kernel.bandwidth))

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
