"""Q-learning on fixed radial bases (QL-FB of chapter 3), with and without gradient correction."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
from numba import njit

from bnprl_agents.agent import Metrics
from bnprl_agents.compiled_values import CompiledValueAgent, register
from bnprl_agents.episodes import BoolArray, FloatArray
from bnprl_agents.gaussian_process.kernels import (
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
    radial,
)
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.q_learning.schedule import check_schedules, learning_rate
from bnprl_agents.settings import Settings, check_entries

MOST_BASES = 10**6
"""Largest number of bases."""
LARGEST_ERROR = 1e100
"""Of a transition; beyond, learning has diverged and stops, with every weight still finite."""


@dataclass(frozen=True)
class LinearQConfig(Settings):
    """Settings of `LinearQ`. The source does not say what t counts: here, transitions."""

    bases: int = 10
    """Centres along each dimension of a Box, evenly spread over its range; a Discrete observation
    has one centre for each value."""
    bandwidth: tuple[float, ...] = (0.1,)
    """Of the bases, one for all dimensions or one for each: in shares of a Box's range, or in cells
    of a grid."""
    initial_rate: float = 0.5
    """c of the learning rate c / t^a."""
    rate_exponent: float = 0.3
    """a of the learning rate; t is the number of the transition."""
    exploration_exponent: float = 0.3
    """b of the exploring probability t^-b at the t-th step."""
    low: tuple[float, ...] = ()
    """Lower ends of the range of a Box that the centres cover; (): its own."""
    high: tuple[float, ...] = ()
    """Upper ends."""
    grid_columns: int = 0
    """Columns of the grid whose cells a Discrete observation counts row by row; 0: all values are
    equally far from each other."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_schedules(self)
        check_bandwidth(self.bandwidth)
        if self.bases < 1:
            raise ValueError(f"bases: {self.bases}, must be at least 1")


@dataclass(frozen=True)
class GQConfig(LinearQConfig):
    """Settings of `GQ`."""

    correction_rate: float = 0.1
    """Learning rate of the second weight vector, as a multiple of the first one's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("correction_rate", self.correction_rate)


class Weights(NamedTuple):
    """Everything that the compiled functions read and change.

    Attributes:
        weights: (A, M) w.
        correction: (A, M) v.
        centres: (M, D) of the bases, in units of the bandwidths.
        bandwidth: (D,).
        discount: gamma.
        initial_rate: c of the learning rate c / t^a.
        rate_exponent: a.
        correction_rate: of v, as a multiple of the learning rate; 0: v is not learned.
        diverged: (1,) whether learning has stopped.
    """

    weights: FloatArray
    correction: FloatArray
    centres: FloatArray
    bandwidth: FloatArray
    discount: float
    initial_rate: float
    rate_exponent: float
    correction_rate: float
    diverged: BoolArray


class LinearQ(CompiledValueAgent):
    """Semi-gradient Q-learning on fixed radial bases: Q(s, a) = w_a' phi(s).

    It may diverge, above all where many bases overlap. When an error passes `LARGEST_ERROR` it
    stops learning and the metric `diverged` is 1; the weights stay finite.

    Paper: dissertation, section 3.5 and appendix 3.7.1 (QL-FB).

    Attributes:
        centres: (M, D) of the bases, in units of the bandwidths.
        weights: (A, M) w.
        correction: (A, M) the second weight vector; always 0 here, see `GQ`.
    """

    Config: ClassVar[type[Any]] = LinearQConfig
    config: LinearQConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: LinearQConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.bandwidth = np.array(
            broadcast_bandwidth(self.config.bandwidth, self.features.dimensions)
        )
        self.centres = np.ascontiguousarray(self._grid(observation_space) / self.bandwidth)
        check_entries("bases, action_space", len(self.centres), self.n_actions)
        self.weights = np.zeros((self.n_actions, len(self.centres)))
        self.correction = np.zeros_like(self.weights)
        self._diverged = np.zeros(1, dtype=np.bool_)

    @property
    def correction_rate(self) -> float:
        """Rate of the second weight vector as a multiple of the first one's; 0: there is none."""
        return 0.0

    @property
    def diverged(self) -> bool:
        """Whether learning has stopped."""
        return bool(self._diverged[0])

    @property
    def learner(self) -> Weights:
        """The weights as they stand."""
        return Weights(
            self.weights,
            self.correction,
            self.centres,
            self.bandwidth,
            self.discount,
            self.config.initial_rate,
            self.config.rate_exponent,
            self.correction_rate,
            self._diverged,
        )

    def values(self, points: FloatArray) -> FloatArray:
        """Return w_a' phi(s), (n, A), at points (n, D)."""
        return self.behaviour_values(points)

    def report(self, error: float) -> Metrics:
        """Report errors, the exploration and whether learning has stopped."""
        return {
            "td_error": error,
            "exploring": self.exploring_probability(),
            "diverged": float(self.diverged),
        }

    def _grid(self, space: gym.Space[Any]) -> FloatArray:
        """Return the centres (M, D) of the bases, as points."""
        if isinstance(space, gym.spaces.Discrete):
            if space.n > MOST_BASES:
                raise ValueError(f"observation_space: {space}, has more than {MOST_BASES:,} bases")
            return self.features.points
        bases, dimensions = self.config.bases, self.features.dimensions
        if bases**dimensions > MOST_BASES:
            raise ValueError(
                f"bases: {bases} in {dimensions} dimensions are more than {MOST_BASES:,}"
            )
        axis = np.linspace(0.0, 1.0, bases) if bases > 1 else np.array([0.5])
        return np.array(list(itertools.product(axis, repeat=dimensions)))

    def learned_arrays(self) -> Arrays:
        """Both weight vectors."""
        return {"weights": self.weights, "correction": self.correction}

    def counters(self) -> dict[str, Any]:
        """The number of transitions learned, and whether learning has stopped."""
        return super().counters() | {"diverged": self.diverged}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self._diverged[0] = bool(counters["diverged"])

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over saved weights."""
        self.weights = taken(arrays, "weights", self.weights.shape)
        self.correction = taken(arrays, "correction", self.weights.shape)


class GQ(LinearQ):
    """Greedy-GQ: the semi-gradient corrected by a second weight vector v.

    w_a += rate (delta phi(s) - gamma (v_a' phi(s)) phi(s') at the greedy action of s'),
    v_a += correction_rate rate (delta - v_a' phi(s)) phi(s).

    Paper: Maei, Szepesvari, Bhatnagar and Sutton (2010), Toward off-policy learning control with
    function approximation, ICML; Maei and Sutton (2010), GQ(lambda), AGI, at lambda = 0.
    """

    Config = GQConfig
    config: GQConfig

    @property
    def correction_rate(self) -> float:
        """Rate of the second weight vector as a multiple of the first one's."""
        return self.config.correction_rate


@njit(cache=True)
def bases(learner, x):  # type: ignore[no-untyped-def]
    """Return phi(s), (M,)."""
    z = x / learner.bandwidth
    phi = np.empty(learner.centres.shape[0])
    for i in range(phi.size):
        phi[i] = radial(z, learner.centres[i], 1.0)
    return phi


@njit(cache=True)
def linear_values(learner, x):  # type: ignore[no-untyped-def]
    """Return w_a' phi(s) of every action, (A,)."""
    return np.dot(learner.weights, bases(learner, x))


@njit(cache=True)
def learn_weights(learner, x, a, r, x_t, terminated, t):  # type: ignore[no-untyped-def]
    """Take a semi-gradient step, corrected where the second weight vector is learned."""
    if learner.diverged[0]:
        return 0.0
    w, v = learner.weights, learner.correction
    rate = learning_rate(learner.initial_rate, learner.rate_exponent, t)
    phi, phi_t = bases(learner, x), bases(learner, x_t)
    values = np.dot(w, phi_t)
    greedy = values.argmax()
    gamma = 0.0 if terminated else learner.discount
    delta = r + gamma * values[greedy] - np.dot(w[a], phi)
    if not abs(delta) <= LARGEST_ERROR:
        learner.diverged[0] = True
        return 0.0
    w[a] += rate * delta * phi
    if learner.correction_rate > 0.0:
        expected = np.dot(v[a], phi)
        w[greedy] -= rate * gamma * expected * phi_t
        v[a] += learner.correction_rate * rate * (delta - expected) * phi
    return abs(delta)


register(Weights, linear_values, learn_weights)
