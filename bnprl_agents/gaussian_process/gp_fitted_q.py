"""Batch Q-iteration with exact Gaussian processes, section 3.4.1: Algorithm 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.fitted_q_iteration import (
    ActionKernel,
    FittedProcess,
    fitted_q_iteration,
)
from bnprl_agents.gaussian_process.kernels import (
    RadialKernel,
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
)
from bnprl_agents.policy_files import Arrays, count, taken
from bnprl_agents.settings import Settings
from bnprl_agents.value_learner import (
    Transitions,
    ValueAgent,
    check_exponent,
    restored_actions,
    restored_transitions,
)


@dataclass(frozen=True)
class GPFittedQConfig(Settings):
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
        super().__post_init__()
        if self.regularization != "auto":
            if not isinstance(self.regularization, (int, float)):
                raise ValueError(f"regularization: {self.regularization!r}, must be 'auto' or > 0")
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


class GPFittedQ(ValueAgent):
    """Fitted Q-iteration with an exact Gaussian process on all tuples seen.

    Every `fit_every` transitions, and at the end of a budget, all tuples are fitted anew. If the
    sweeps diverge, which a small regularization allows, the fit is given up, the values of the last
    good fit stay, and the metric `diverged` is 1.

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
        self.kernel = ActionKernel(RadialKernel(bandwidth, self.config.amplitude), joint)
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
        design = self.kernel.every_action(points, self.n_actions, basis, actions)
        values: FloatArray = design @ weights
        return values

    def learn(self, transitions: Transitions) -> Metrics:
        """Keep the transitions, and fit when enough are new."""
        both = zip(self.tuples, transitions, strict=True)
        self.tuples = Transitions(
            *(np.concatenate(parts)[-self.config.capacity :] for parts in both)
        )
        self._since_fit += len(transitions.actions)
        if self._since_fit < self.config.fit_every:
            return {}
        return self.fit()

    def finish(self) -> Metrics:
        """Fit what came after the last fit; see `Agent.finish`."""
        return self.fit() if self._since_fit else {}

    def fit(self) -> Metrics:
        """Fit all tuples; report the sweeps, the regularization used and whether it diverged.

        Raises:
            ValueError: the regularization is too small for tuples that repeat.
        """
        self._since_fit = 0
        points, actions, rewards, next_points, terminated = self.tuples
        process = FittedProcess(self.kernel, points, actions, self.config.regularization)
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
        self._since_fit = count("since_fit", counters["since_fit"])

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over saved tuples and their fit."""
        dimensions = self.features.dimensions
        self.tuples = restored_transitions(arrays, "tuple_", dimensions, self.n_actions)
        if "fitted_weights" in arrays:
            m = len(arrays["fitted_weights"])
            self._fitted = (
                taken(arrays, "fitted_points", (m, dimensions)),
                restored_actions(arrays, "fitted_actions", self.n_actions),
                taken(arrays, "fitted_weights", (m,)),
            )
