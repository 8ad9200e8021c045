"""Q-iteration by an exact Gaussian process on a fixed set of tuples: Algorithm 1, Theorem 4."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from bnprl_agents.episodes import BoolArray, FloatArray, IntArray
from bnprl_agents.gaussian_process.kernels import RadialKernel

LEAST_NOISE = 1e-6
"""Of `sufficient_regularization`, as a share of k_max: a single tuple needs none."""
GROWING_SWEEPS = 5
"""Sweeps in a row whose changes all grow before the iteration counts as diverging."""


def sufficient_regularization(gram: FloatArray) -> float:
    """Return omega^2 = 2 (||K||_inf - k_max), with which a sweep is a contraction; Theorem 4.

    Args:
        gram: (N, N) kernel matrix of all tuples.
    """
    largest = float(np.diag(gram).max())
    row_sum = float(np.abs(gram).sum(axis=1).max())
    return max(2.0 * (row_sum - largest), LEAST_NOISE * largest)


class ActionKernel(NamedTuple):
    """The kernel between pairs (s, a): of one process over both, or of one for each action.

    Attributes:
        kernel: over [s, a] if joint, else over s.
        joint: whether there is one process.
    """

    kernel: RadialKernel
    joint: bool

    def __call__(
        self, points: FloatArray, actions: IntArray, basis: FloatArray, basis_actions: IntArray
    ) -> FloatArray:
        """Return the matrix (n, m) between n pairs and m of a basis."""
        if self.joint:
            left = np.column_stack([points, actions])
            return self.kernel(left, np.column_stack([basis, basis_actions]))
        masked: FloatArray = self.kernel(points, basis) * (actions[:, None] == basis_actions)
        return masked

    def every_action(
        self, points: FloatArray, n_actions: int, basis: FloatArray, basis_actions: IntArray
    ) -> FloatArray:
        """Return the kernel (n, A, m) between every action at n points and m pairs of a basis."""
        every = [np.full(len(points), action) for action in range(n_actions)]
        return np.stack([self(points, a, basis, basis_actions) for a in every], axis=1)


class FittedProcess:
    """An exact Gaussian process over (s, a) on N tuples, for any targets.

    Args:
        kernel: between pairs (s, a).
        points: (N, D) states.
        actions: (N,).
        regularization: omega^2, or "auto".

    Raises:
        ValueError: omega^2 is too small for tuples that repeat, or nearly.
    """

    def __init__(
        self,
        kernel: ActionKernel,
        points: FloatArray,
        actions: IntArray,
        regularization: float | Literal["auto"],
    ) -> None:
        self._kernel, self._points, self._actions = kernel, points, actions
        gram = kernel(points, actions, points, actions)
        self.regularization = (
            sufficient_regularization(gram) if regularization == "auto" else regularization
        )
        try:
            self._factor = cho_factor(gram + self.regularization * np.eye(len(actions)))
        except LinAlgError as error:
            raise ValueError(
                f"regularization: {self.regularization:g}, too small for tuples that repeat, whose "
                f"kernel matrix is singular; {LEAST_NOISE:g} of the amplitude would do, or 'auto'"
            ) from error

    def weights(self, targets: FloatArray) -> FloatArray:
        """Return (K + omega^2 I)^-1 y, (N,)."""
        solved: FloatArray = cho_solve(self._factor, targets)
        return solved

    def design(self, points: FloatArray, n_actions: int) -> FloatArray:
        """Return k([s, a], tuples), (n, A, N), so that Q(s, a) is its product with weights."""
        return self._kernel.every_action(points, n_actions, self._points, self._actions)


class Fit:
    """The sweeps of one fit: how the largest value changes, and whether it converges.

    Attributes:
        targets: (N,) the newest y.
        changes: largest change of a target in each sweep.
        largest: largest |Q| over the tuples' next states after each sweep.
        diverged: whether the changes grew steadily, so that the iteration was stopped.
    """

    def __init__(self, targets: FloatArray) -> None:
        self.targets = targets
        self.changes: list[float] = []
        self.largest: list[float] = []
        self.diverged = False


def fitted_q_iteration(
    process: FittedProcess,
    rewards: FloatArray,
    next_points: FloatArray,
    terminated: BoolArray,
    next_values: FloatArray,
    *,
    discount: float,
    sweeps: int,
    precision: float,
    stop_when_diverging: bool = True,
) -> Fit:
    """Iterate y = r + gamma max_b Q(s', b), Q fitted to the last y; Algorithm 1.

    Args:
        process: of the tuples.
        rewards: (N,).
        next_points: (N, D).
        terminated: (N,).
        next_values: (N, A) Q(s', b) to begin with.
        discount: gamma.
        sweeps: largest number of sweeps.
        precision: stop when no target changes by more.
        stop_when_diverging: stop after `GROWING_SWEEPS` whose changes grow, else report only.
    """

    def backup(values: FloatArray) -> FloatArray:
        return rewards + discount * np.where(terminated, 0.0, values.max(axis=1))

    design = process.design(next_points, next_values.shape[1])
    fit, growing = Fit(backup(next_values)), 0
    for _ in range(sweeps):
        values = design @ process.weights(fit.targets)
        targets = backup(values)
        change = float(np.abs(targets - fit.targets).max())
        growing = growing + 1 if fit.changes and change > fit.changes[-1] else 0
        if not np.isfinite(targets).all() or growing >= GROWING_SWEEPS:
            fit.diverged = True
            if stop_when_diverging or not np.isfinite(targets).all():
                break
        fit.targets = targets
        fit.changes.append(change)
        fit.largest.append(float(np.abs(values).max()))
        if change <= precision:
            break
    return fit
