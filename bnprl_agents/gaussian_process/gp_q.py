"""Online Q-learning with sparse Gaussian processes, section 3.4: Algorithm 2 and its optimist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.agent import Metrics
from bnprl_agents.compiled_values import CompiledValueAgent, learn_in_order, register
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.kernels import (
    RadialKernel,
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
)
from bnprl_agents.gaussian_process.marginal_likelihood import select_hyperparameters
from bnprl_agents.gaussian_process.sparse_gp import (
    TOLERANCE_FLOOR,
    Basis,
    check_forgetting,
    check_sparsity,
    empty_basis,
    mean,
    mean_and_variance,
    update,
)
from bnprl_agents.policy_files import Arrays
from bnprl_agents.value_learner import Transitions, check_exponent, taken

OPTIMISM = 2.0
"""Variances by which the optimistic variant overestimates; section 3.4.3."""


@dataclass(frozen=True)
class GPQConfig:
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
    amplitude: float = 1.0
    """Prior variance of the values, whose prior mean is 0."""
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
        if self.exploration not in ("epsilon", "optimistic"):
            raise ValueError(
                f"exploration: {self.exploration!r}, must be 'epsilon' or 'optimistic'"
            )
        if self.inputs not in ("per-action", "joint"):
            raise ValueError(f"inputs: {self.inputs!r}, must be 'per-action' or 'joint'")
        check_exponent("exploration_exponent", self.exploration_exponent)
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


class Prior(NamedTuple):
    """What the processes assume.

    Attributes:
        bandwidth: (D,) of the kernel.
        amplitude: prior variance.
        noise: variance of a measurement.
        tolerance: novelty that a basis point needs.
        budget: basis points at most.
        forgetting: factor of C before each measurement.
    """

    bandwidth: FloatArray
    amplitude: float
    noise: float
    tolerance: float
    budget: int
    forgetting: float


class Inputs(NamedTuple):
    """Where Q(s, a) is found: process `owner[a]` at the point [s, code[a]].

    Attributes:
        owner: (A,).
        code: (A, 0) per action, (A, 1) joint.
    """

    owner: IntArray
    code: FloatArray


class Processes(NamedTuple):
    """Everything that the compiled functions read and change.

    Attributes:
        basis: the processes' states, with a leading axis of processes.
        inputs: where Q(s, a) is found.
        prior: what the processes assume.
        optimism: variances that are added to a mean.
        discount: gamma.
    """

    basis: Basis
    inputs: Inputs
    prior: Prior
    optimism: float
    discount: float


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
        joint = self.config.inputs == "joint"
        actions = np.arange(self.n_actions)
        self.inputs = Inputs(
            np.zeros_like(actions) if joint else actions,
            actions[:, None].astype(np.float64) if joint else np.zeros((self.n_actions, 0)),
        )
        dimensions = self.features.dimensions + self.inputs.code.shape[1]
        self.prior = Prior(
            np.array(broadcast_bandwidth(self.config.bandwidth, dimensions)),
            self.config.amplitude,
            self.config.noise,
            max(self.config.tolerance, TOLERANCE_FLOOR),
            self.config.budget,
            self.config.forgetting,
        )
        self.basis = self._empty()
        self._kept: list[Transitions] = []

    @property
    def learner(self) -> Processes:
        """The processes as they stand."""
        return self._processes(OPTIMISM if self._optimistic else 0.0)

    def values(self, points: FloatArray) -> FloatArray:
        """Return the posterior means (n, A) at points (n, D); (3.6)."""
        values: FloatArray = q_values(self._processes(0.0), points)
        return values

    def variances(self, points: FloatArray) -> FloatArray:
        """Return the posterior variances (n, A), without the noise, at points (n, D); (3.7)."""
        variances: FloatArray = q_values(self._processes(1.0), points) - self.values(points)
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
            targets,
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
        if "kept_points" in arrays:
            self._kept = [Transitions(*(arrays[f"kept_{name}"] for name in Transitions._fields))]

    def _empty(self) -> Basis:
        processes = int(self.inputs.owner.max()) + 1
        return empty_basis(self.prior.budget + 1, self.prior.bandwidth.size, processes)


@njit(cache=True)
def process(basis, a):  # type: ignore[no-untyped-def]
    """Return the state of one process: views of the arrays of all."""
    return Basis(
        basis.points[a],
        basis.weights[a],
        basis.covariance[a],
        basis.precision[a],
        basis.kernel[a],
        basis.size[a],
    )


@njit(cache=True)
def joined(point, code, bandwidth):  # type: ignore[no-untyped-def]
    """Return [s, code] in units of the bandwidths."""
    d = point.size
    z = np.empty(bandwidth.size)
    z[:d], z[d:] = point / bandwidth[:d], code / bandwidth[d:]
    return z


@njit(cache=True)
def q_value(processes, point, action):  # type: ignore[no-untyped-def]
    """Return m(s, a) + optimism var(s, a)."""
    basis, inputs, prior, optimism, _ = processes
    z = joined(point, inputs.code[action], prior.bandwidth)
    state = process(basis, inputs.owner[action])
    if optimism == 0.0:
        return mean(state, z, prior.amplitude)
    m, v = mean_and_variance(state, z, prior.amplitude)
    return m + optimism * v


@njit(cache=True)
def action_values(processes, point):  # type: ignore[no-untyped-def]
    """Return m(s, a) + optimism var(s, a) of every action, (A,)."""
    values = np.empty(processes.inputs.owner.size)
    for a in range(values.size):
        values[a] = q_value(processes, point, a)
    return values


@njit(cache=True)
def q_values(processes, points):  # type: ignore[no-untyped-def]
    """Return the same (n, A) at points (n, D)."""
    values = np.empty((points.shape[0], processes.inputs.owner.size))
    for i in range(points.shape[0]):
        values[i] = action_values(processes, points[i])
    return values


@njit(cache=True)
def learn_measurement(processes, x, a, r, x_t, terminated, t):  # type: ignore[no-untyped-def]
    """Measure y = r + gamma max_b [m(s', b) + optimism var(s', b)] of Q(s, a); (3.5)."""
    basis, inputs, prior, _, discount = processes
    y = r
    if not terminated:
        y += discount * action_values(processes, x_t).max()
    z = joined(x, inputs.code[a], prior.bandwidth)
    state = process(basis, inputs.owner[a])
    error = update(
        state,
        z,
        y,
        prior.amplitude,
        prior.noise,
        prior.tolerance,
        prior.budget,
        prior.forgetting,
    )
    return abs(error)


register(Processes, action_values, learn_measurement)
