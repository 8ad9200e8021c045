"""Batch Q-iteration with exact Gaussian processes, section 3.4.1: Algorithm 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bnprl_agents.agent import Metrics
from bnprl_agents.episodes import BoolArray, FloatArray, IntArray
from bnprl_agents.gaussian_process.kernels import (
    RadialKernel,
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
)
from bnprl_agents.policy_files import Arrays
from bnprl_agents.value_learner import Transitions, ValueAgent, check_exponent, taken

LEAST_NOISE = 1e-6
"""Of `sufficient_regularization`, as a share of k_max: a single tuple needs none."""
GROWING_SWEEPS = 5
"""Sweeps in a row whose changes all grow before the iteration counts as diverging."""


@dataclass(frozen=True)
class GPFittedQConfig:
    """Settings of `GPFittedQ`."""

    regularization: float | Literal["auto"] = "auto"
    """Variance omega^2 of the measurements. auto: 2 (||K||_inf - k_max), with which every sweep is
    a contraction (Theorem 4)."""
    sweeps: int = 200
    """Largest number of sweeps of one fit."""
    precision: float = 1e-6
    """A fit ends when no target changes by more than this."""
    fit_every: int = 100
    """Transitions between two fits."""
    capacity: int = 1000
    """Tuples kept; when they are more, the oldest are forgotten. A fit costs O(capacity^3)."""
    initial_value: float = 0.0
    """Q before the first fit."""
    bandwidth: tuple[float, ...] = (0.1,)
    """Of the kernel, one for all dimensions or one for each: in shares of a Box's range, or in
    cells of a grid. With joint inputs the action is one more dimension, counted 0, 1, 2, ..."""
    amplitude: float = 1.0
    """Prior variance of the values, whose prior mean is 0."""
    inputs: Literal["per-action", "joint"] = "per-action"
    """per-action: a process for each action, over the states. joint: one over both."""
    exploration_exponent: float = 0.3
    """b of the exploring probability t^-b at the t-th step."""
    low: tuple[float, ...] = ()
    """Lower ends of the range of a Box; (): its own."""
    high: tuple[float, ...] = ()
    """Upper ends."""
    grid_columns: int = 0
    """Columns of the grid whose cells a Discrete observation counts row by row; 0: all values are
    equally far from each other."""

    def __post_init__(self) -> None:
        if isinstance(self.regularization, str):
            if self.regularization != "auto":
                raise ValueError(f"regularization: {self.regularization!r}, must be 'auto' or > 0")
        else:
            check_positive("regularization", self.regularization)
        for name in ("sweeps", "fit_every", "capacity"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: {getattr(self, name)}, must be at least 1")
        check_positive("precision", self.precision)
        if not np.isfinite(self.initial_value):
            raise ValueError(f"initial_value: {self.initial_value}, must be finite")
        check_bandwidth(self.bandwidth)
        check_positive("amplitude", self.amplitude)
        if self.inputs not in ("per-action", "joint"):
            raise ValueError(f"inputs: {self.inputs!r}, must be 'per-action' or 'joint'")
        check_exponent("exploration_exponent", self.exploration_exponent)


def sufficient_regularization(gram: FloatArray) -> float:
    """Return omega^2 = 2 (||K||_inf - k_max), with which a sweep is a contraction; Theorem 4.

    Args:
        gram: (N, N) kernel matrix of all tuples.
    """
    largest = float(np.diag(gram).max())
    row_sum = float(np.abs(gram).sum(axis=1).max())
    return max(2.0 * (row_sum - largest), LEAST_NOISE * largest)


class FittedProcess:
    """An exact Gaussian process over (s, a) on N tuples, for any targets.

    Args:
        kernel: over [s, a] for joint inputs, else over s.
        joint: whether there is one process over both, or one for each action.
        points: (N, D) states.
        actions: (N,).
        regularization: omega^2, or "auto".
    """

    def __init__(
        self,
        kernel: RadialKernel,
        joint: bool,
        points: FloatArray,
        actions: IntArray,
        regularization: float | Literal["auto"],
    ) -> None:
        self._kernel, self._joint = kernel, joint
        self._points, self._actions = points, actions
        gram = self._cross(points, actions)
        self.regularization = (
            sufficient_regularization(gram) if regularization == "auto" else regularization
        )
        self._factor = cho_factor(gram + self.regularization * np.eye(len(actions)))

    def weights(self, targets: FloatArray) -> FloatArray:
        """Return (K + omega^2 I)^-1 y, (N,)."""
        solved: FloatArray = cho_solve(self._factor, targets)
        return solved

    def design(self, points: FloatArray, n_actions: int) -> FloatArray:
        """Return k([s, a], tuples), (n, A, N), so that Q(s, a) is its product with weights."""
        every = [np.full(len(points), action) for action in range(n_actions)]
        return np.stack([self._cross(points, action) for action in every], axis=1)

    def _cross(self, points: FloatArray, actions: IntArray) -> FloatArray:
        if self._joint:
            left = np.column_stack([points, actions])
            return self._kernel(left, np.column_stack([self._points, self._actions]))
        masked: FloatArray = self._kernel(points, self._points) * (
            actions[:, None] == self._actions[None]
        )
        return masked


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


class GPFittedQ(ValueAgent):
    """Fitted Q-iteration with an exact Gaussian process on all tuples seen.

    Every `fit_every` transitions all tuples are fitted anew. If the sweeps diverge, which a small
    regularization allows, the fit is given up, the values of the last good fit stay, and the
    metric `diverged` is 1.

    Paper: dissertation, section 3.4.1, Algorithm 1 with its misprint corrected (the new process is
    trained, then replaces the old one).

    Attributes:
        tuples: all that is kept.
    """

    Config = GPFittedQConfig
    config: GPFittedQConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: GPFittedQConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        joint = self.config.inputs == "joint"
        dimensions = self.features.dimensions
        bandwidth = broadcast_bandwidth(self.config.bandwidth, dimensions + joint)
        self.kernel = RadialKernel(bandwidth, self.config.amplitude)
        self.tuples = Transitions(
            np.zeros((0, dimensions)),
            np.zeros(0, dtype=np.int64),
            np.zeros(0),
            np.zeros((0, dimensions)),
            np.zeros(0, dtype=np.bool_),
        )
        self._since_fit = 0
        self._fitted: tuple[FloatArray, IntArray, FloatArray] | None = None

    def values(self, points: FloatArray) -> FloatArray:
        """Return the mean (n, A) of the last fit."""
        if self._fitted is None:
            return np.full((len(points), self.n_actions), self.config.initial_value)
        basis, actions, weights = self._fitted
        columns = [points] * self.n_actions
        if self.config.inputs == "joint":
            columns = [
                np.column_stack([points, np.full(len(points), a)]) for a in range(self.n_actions)
            ]
            basis = np.column_stack([basis, actions])
            return np.stack([self.kernel(x, basis) @ weights for x in columns], axis=1)
        cross = self.kernel(points, basis)
        return np.stack([cross @ (weights * (actions == a)) for a in range(self.n_actions)], axis=1)

    def learn(self, transitions: Transitions) -> Metrics:
        """Keep the transitions, and fit when enough are new."""
        both = zip(self.tuples, transitions, strict=True)
        self.tuples = Transitions(
            *(np.concatenate(parts)[-self.config.capacity :] for parts in both)
        )
        self._since_fit += len(transitions.actions)
        if self._since_fit < self.config.fit_every:
            return {}
        self._since_fit = 0
        return self.fit()

    def fit(self) -> Metrics:
        """Fit all tuples; report the sweeps, the regularization used and whether it diverged."""
        points, actions, rewards, next_points, terminated = self.tuples
        process = FittedProcess(
            self.kernel,
            self.config.inputs == "joint",
            points,
            actions,
            self.config.regularization,
        )
        fit = fitted_q_iteration(
            process,
            rewards,
            next_points,
            terminated,
            self.values(next_points),
            discount=self.discount,
            sweeps=self.config.sweeps,
            precision=self.config.precision,
        )
        if not fit.diverged:
            self._fitted = points, actions, process.weights(fit.targets)
        return {
            "sweeps": float(len(fit.changes)),
            "change": fit.changes[-1] if fit.changes else 0.0,
            "regularization": process.regularization,
            "diverged": float(fit.diverged),
        }

    def learned_arrays(self) -> Arrays:
        """The tuples and the last fit."""
        arrays: Arrays = {f"tuple_{name}": part for name, part in self.tuples._asdict().items()}
        if self._fitted is not None:
            names = ("fitted_points", "fitted_actions", "fitted_weights")
            arrays |= dict(zip(names, self._fitted, strict=True))
        return arrays

    def counters(self) -> dict[str, Any]:
        """The numbers of transitions, in all and since the last fit."""
        return super().counters() | {"since_fit": self._since_fit}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self._since_fit = int(counters["since_fit"])

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over saved tuples and their fit."""
        dimensions = self.features.dimensions
        n = len(arrays["tuple_actions"])
        self.tuples = Transitions(
            taken(arrays, "tuple_points", (n, dimensions)),
            arrays["tuple_actions"].astype(np.int64),
            taken(arrays, "tuple_rewards", (n,)),
            taken(arrays, "tuple_next_points", (n, dimensions)),
            arrays["tuple_terminated"].astype(np.bool_),
        )
        if "fitted_weights" in arrays:
            m = len(arrays["fitted_weights"])
            self._fitted = (
                taken(arrays, "fitted_points", (m, dimensions)),
                arrays["fitted_actions"].astype(np.int64),
                taken(arrays, "fitted_weights", (m,)),
            )
