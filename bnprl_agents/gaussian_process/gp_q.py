"""Online Q-learning with sparse Gaussian processes, section 3.4: Algorithm 2 and its optimist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.compiled_values import CompiledValueAgent, learn_in_order, values_at
from bnprl_agents.episodes import FloatArray
from bnprl_agents.gaussian_process.basis import Basis, empty_basis
from bnprl_agents.gaussian_process.kernels import (
    RadialKernel,
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
)
from bnprl_agents.gaussian_process.marginal_likelihood import select_hyperparameters
from bnprl_agents.gaussian_process.q_processes import Inputs, Prior, Processes
from bnprl_agents.gaussian_process.sparse_gp import (
    TOLERANCE_FLOOR,
    check_forgetting,
    check_sparsity,
)
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.settings import Settings
from bnprl_agents.value_learner import Transitions, check_exponent, restored_transitions

OPTIMISM = 2.0
"""Variances by which the optimistic variant overestimates; section 3.4.3."""


@dataclass(frozen=True)
class GPQConfig(Settings):
    """Settings of `GPQ`. The source prints no bandwidth and no tolerance."""

    exploration: Literal["epsilon", "optimistic"] = "epsilon"
    """epsilon: random actions now and then. optimistic: greedy on mean + 2 variances, which are
    backed up too."""
    exploration_exponent: float = 0.3
    """b of the exploring probability t^-b at the t-th step; of no use to the optimist."""
    budget: int = 100
    """Largest number of basis points of each process."""
    bandwidth: tuple[float, ...] = (0.1,)
    """Of the kernel, one for all dimensions or one for each: in shares of a Box's range, or in
    cells of a grid. With joint inputs the action is one more dimension, counted 0, 1, 2, ..."""
    prior_mean: float = 0.0
    """Prior mean of the values; 0 is the source's. Where every step costs something, 0 is so
    hopeful that each action must be tried many times in each place before it looks bad."""
    amplitude: float = 1.0
    """Prior variance of the values."""
    noise: float = 0.1
    """Variance of the measurements r + gamma max Q; it regularises."""
    tolerance: float = 1e-3
    """Novelty, as a share of the amplitude, above which a point joins the basis."""
    forgetting: float = 1.0
    """Factor by which a process forgets before each measurement (its C shrinks, its variance grows
    back); 1, the source's, never: later targets then weigh as little as the first, wrong ones."""
    inputs: Literal["per-action", "joint"] = "per-action"
    """per-action: a process for each action, over the states. joint: one over both."""
    select_after: int = 0
    """Steps after which bandwidths, amplitude and noise are chosen once by marginal likelihood of
    the transitions seen so far; 0: the values above stay."""
    low: tuple[float, ...] = ()
    """Lower ends of the range of a Box; (): its own."""
    high: tuple[float, ...] = ()
    """Upper ends."""
    grid_columns: int = 0
    """Columns of the grid whose cells a Discrete observation counts row by row; 0: all values are
    equally far from each other."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exploration not in ("epsilon", "optimistic"):
            raise ValueError(
                f"exploration: {self.exploration!r}, must be 'epsilon' or 'optimistic'"
            )
        if self.inputs not in ("per-action", "joint"):
            raise ValueError(f"inputs: {self.inputs!r}, must be 'per-action' or 'joint'")
        check_exponent("exploration_exponent", self.exploration_exponent)
        if not np.isfinite(self.prior_mean):
            raise ValueError(f"prior_mean: {self.prior_mean}, must be finite")
        check_bandwidth(self.bandwidth)
        check_positive("amplitude", self.amplitude)
        check_positive("noise", self.noise)
        check_sparsity(self.budget, self.tolerance)
        check_forgetting(self.forgetting)
        if self.select_after < 0:
            raise ValueError(f"select_after: {self.select_after}, must not be negative")


@dataclass(frozen=True)
class OptimisticGPQConfig(GPQConfig):
    """Settings of `GPQ`, optimistic unless told otherwise."""

    exploration: Literal["epsilon", "optimistic"] = "optimistic"


class GPQ(CompiledValueAgent):
    """Q-learning whose action values are sparse online Gaussian processes.

    A transition is a measurement y = r + gamma max_b m(s', b) of Q(s, a) with Gaussian noise; at a
    termination y = r. The basis points are chosen from the data by their novelty and kept within
    the budget, so that a step costs O(A budget + budget^2), compiled, and the memory is constant.
    The optimistic variant backs up max_b [m(s', b) + 2 var(s', b)] and acts greedily by the same
    sum; its learned policy is greedy by the mean.

    Paper: dissertation, section 3.4, Algorithm 2.

    Attributes:
        prior: kernel, noise and budget.
        basis: the processes' states, with a leading axis of processes.
    """

    Config = GPQConfig
    config: GPQConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: GPQConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        dimensions = self.features.dimensions + self._joint
        self.prior = Prior(
            self.config.prior_mean,
            np.array(broadcast_bandwidth(self.config.bandwidth, dimensions)),
            self.config.amplitude,
            self.config.noise,
            max(self.config.tolerance, TOLERANCE_FLOOR),
            self.config.budget,
            self.config.forgetting,
        )
        self.basis = self._empty()
        actions = np.arange(self.n_actions)
        self.inputs = Inputs(
            np.zeros_like(actions) if self._joint else actions,
            actions[:, None].astype(np.float64) if self._joint else np.zeros((self.n_actions, 0)),
        )
        self._kept: list[Transitions] = []

    @property
    def learner(self) -> Processes:
        """The processes as they stand."""
        return self._processes(OPTIMISM if self._optimistic else 0.0)

    def values(self, points: FloatArray) -> FloatArray:
        """Return the posterior means (n, A) at points (n, D); (3.6)."""
        values: FloatArray = values_at(self._processes(0.0), points, self.n_actions)
        return values

    def variances(self, points: FloatArray) -> FloatArray:
        """Return the posterior variances (n, A), without the noise, at points (n, D); (3.7)."""
        with_variance = values_at(self._processes(1.0), points, self.n_actions)
        variances: FloatArray = with_variance - self.values(points)
        return variances

    @property
    def explores(self) -> bool:
        """Whether random actions are taken: the optimist takes none."""
        return not self._optimistic

    @property
    def compiles(self) -> bool:
        """Whether training may be compiled: not where hyper-parameters are chosen on the way."""
        return self.config.select_after == 0

    def basis_points(self) -> list[FloatArray]:
        """Return the basis points (m, D) of each process, as points of `features`."""
        return [
            points[: int(size)] * self.prior.bandwidth
            for points, (size,) in zip(self.basis.points, self.basis.size, strict=True)
        ]

    def learn(self, transitions: Transitions) -> Metrics:
        """Take the transitions as measurements, one after the other; Algorithm 2."""
        metrics = super().learn(transitions)
        if self.steps < self.config.select_after:
            self._kept.append(transitions)
            if self.steps + len(transitions.actions) >= self.config.select_after:
                self._select()
        return metrics

    def report(self, error: float) -> Metrics:
        """Report errors, the size of the basis and the exploration."""
        return {
            "td_error": error,
            "basis_points": float(self.basis.size.sum()),
            "exploring": self.exploring_probability(),
        }

    @property
    def _optimistic(self) -> bool:
        return self.config.exploration == "optimistic"

    @property
    def _joint(self) -> bool:
        return self.config.inputs == "joint"

    def _processes(self, optimism: float) -> Processes:
        return Processes(self.basis, self.inputs, self.prior, optimism, self.discount)

    def _select(self) -> None:
        """Choose the hyper-parameters by what was seen, and learn it again under them."""
        kept = Transitions(*map(np.concatenate, zip(*self._kept, strict=True)))
        targets = kept.rewards + self.discount * np.where(
            kept.terminated, 0.0, self.values(kept.next_points).max(axis=1)
        )
        kernel, noise = select_hyperparameters(
            RadialKernel(tuple(self.prior.bandwidth), self.prior.amplitude),
            self.prior.noise,
            np.concatenate([kept.points, self.inputs.code[kept.actions]], axis=1),
            targets - self.prior.mean,
            groups=self.inputs.owner[kept.actions],
        )
        self.prior = self.prior._replace(
            bandwidth=np.array(kernel.bandwidth), amplitude=kernel.amplitude, noise=noise
        )
        self.basis, self._kept = self._empty(), []
        learn_in_order(self.learner, 0, *kept)

    def learned_arrays(self) -> Arrays:
        """The processes, their hyper-parameters, and what these will be chosen by."""
        arrays: Arrays = dict(self.basis._asdict())
        arrays = {f"basis_{name}": array for name, array in arrays.items()}
        arrays["bandwidth"] = self.prior.bandwidth
        arrays["hyperparameters"] = np.array([self.prior.amplitude, self.prior.noise])
        if self._kept:
            kept = Transitions(*map(np.concatenate, zip(*self._kept, strict=True)))
            arrays |= {f"kept_{name}": array for name, array in kept._asdict().items()}
        return arrays

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over saved processes."""
        size = arrays["basis_size"]
        if (
            size.shape != self.basis.size.shape
            or (size < 0).any()
            or (size > self.prior.budget).any()
        ):
            raise ValueError("basis_size does not fit the budget")
        shapes = {name: array.shape for name, array in self.basis._asdict().items()}
        floats = {n: taken(arrays, f"basis_{n}", s) for n, s in shapes.items() if n != "size"}
        self.basis = Basis(**floats, size=size.astype(np.int64))
        bandwidth = taken(arrays, "bandwidth", self.prior.bandwidth.shape)
        amplitude, noise = taken(arrays, "hyperparameters", (2,)).tolist()
        kernel = RadialKernel(tuple(bandwidth.tolist()), amplitude)  # checks them
        check_positive("noise", noise)
        self.prior = self.prior._replace(
            bandwidth=np.array(kernel.bandwidth), amplitude=amplitude, noise=noise
        )
        if "kept_actions" in arrays:
            dimensions = self.features.dimensions
            self._kept = [restored_transitions(arrays, "kept_", dimensions, self.n_actions)]

    def _empty(self) -> Basis:
        processes = 1 if self._joint else self.n_actions
        return empty_basis(self.prior.budget + 1, self.prior.bandwidth.size, processes)
