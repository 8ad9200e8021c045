"""Q-learning on fixed radial bases (QL-FB of chapter 3), with and without gradient correction."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numba import njit

from bnprl_agents.agent import Metrics
from bnprl_agents.episodes import FloatArray
from bnprl_agents.gaussian_process.kernels import (
    broadcast_bandwidth,
    check_bandwidth,
    check_positive,
    radial,
)
from bnprl_agents.policy_files import Arrays
from bnprl_agents.q_learning.schedule import check_schedules, learning_rate
from bnprl_agents.value_learner import Transitions, ValueAgent, taken

LARGEST_ERROR = 1e100
"""Of a transition; beyond, learning has diverged and stops, with every weight still finite."""


@dataclass(frozen=True)
class LinearQConfig:
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


class LinearQ(ValueAgent):
    """Semi-gradient Q-learning on fixed radial bases: Q(s, a) = w_a' phi(s).

    It may diverge, above all where many bases overlap. When an error passes `LARGEST_ERROR` it
    stops learning and the metric `diverged` is 1; the weights stay finite.

    Paper: dissertation, section 3.5 and appendix 3.7.1 (QL-FB).

    Attributes:
        centres: (M, D) of the bases, in units of the bandwidths.
        weights: (A, M) w.
        correction: (A, M) the second weight vector; always 0 here, see `GQ`.
        diverged: whether learning has stopped.
    """

    Config: Any = LinearQConfig
    config: LinearQConfig
    bounded = True

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
        if isinstance(observation_space, gym.spaces.Discrete):
            centres = self.features.points
        else:
            axis = np.linspace(0.0, 1.0, self.config.bases + 2)[1:-1]
            if self.config.bases > 1:
                axis = np.linspace(0.0, 1.0, self.config.bases)
            if self.config.bases**self.features.dimensions > 10**6:
                raise ValueError(
                    f"bases: {self.config.bases} in {self.features.dimensions} dimensions are more "
                    "than 1,000,000"
                )
            centres = np.array(list(itertools.product(axis, repeat=self.features.dimensions)))
        self.centres = np.ascontiguousarray(centres / self.bandwidth)
        self.weights = np.zeros((self.n_actions, len(self.centres)))
        self.correction = np.zeros_like(self.weights)
        self.diverged = False

    @property
    def correction_rate(self) -> float:
        """Rate of the second weight vector as a multiple of the first one's; 0: there is none."""
        return 0.0

    def values(self, points: FloatArray) -> FloatArray:
        """Return w_a' phi(s), (n, A), at points (n, D)."""
        return linear_values(self.weights, self.centres, points / self.bandwidth)

    def learn(self, transitions: Transitions) -> Metrics:
        """Take a semi-gradient step for each transition, one after the other."""
        if self.diverged:
            return {"diverged": 1.0}
        error = learn_linear(
            self.weights,
            self.correction,
            self.centres,
            transitions.points / self.bandwidth,
            transitions.actions,
            transitions.rewards,
            transitions.next_points / self.bandwidth,
            transitions.terminated,
            self.discount,
            self.config.initial_rate,
            self.config.rate_exponent,
            self.correction_rate,
            self.steps,
        )
        self.diverged = error > LARGEST_ERROR
        return {
            "td_error": float(error),
            "exploring": self.exploring_probability(),
            "diverged": float(self.diverged),
        }

    def learned_arrays(self) -> Arrays:
        """Both weight vectors."""
        return {"weights": self.weights, "correction": self.correction}

    def counters(self) -> dict[str, Any]:
        """The number of transitions learned, and whether learning has stopped."""
        return super().counters() | {"diverged": self.diverged}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.diverged = bool(counters["diverged"])

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
def bases(x, centres):  # type: ignore[no-untyped-def]
    """Return phi(s), (M,)."""
    phi = np.empty(centres.shape[0])
    for i in range(phi.size):
        phi[i] = radial(x, centres[i], 1.0)
    return phi


@njit(cache=True)
def linear_values(weights, centres, points):  # type: ignore[no-untyped-def]
    """Return the values (n, A) at points (n, D)."""
    values = np.empty((points.shape[0], weights.shape[0]))
    for i in range(points.shape[0]):
        values[i] = np.dot(weights, bases(points[i], centres))
    return values


@njit(cache=True)
def learn_linear(  # type: ignore[no-untyped-def]
    weights,
    correction,
    centres,
    points,
    actions,
    rewards,
    next_points,
    terminated,
    discount,
    initial_rate,
    exponent,
    correction_rate,
    steps,
):
    """Learn transitions in order; return the mean |delta|, or the one with which it diverged."""
    total = 0.0
    for i in range(actions.size):
        a, rate = actions[i], learning_rate(initial_rate, exponent, steps + i)
        phi, phi_t = bases(points[i], centres), bases(next_points[i], centres)
        values = np.dot(weights, phi_t)
        greedy = values.argmax()
        gamma = 0.0 if terminated[i] else discount
        delta = rewards[i] + gamma * values[greedy] - np.dot(weights[a], phi)
        if not abs(delta) <= LARGEST_ERROR:
            return np.inf
        if correction_rate > 0.0:
            expected = np.dot(correction[a], phi)
            weights[greedy] -= rate * gamma * expected * phi_t
            correction[a] += correction_rate * rate * (delta - expected) * phi
        weights[a] += rate * delta * phi
        total += abs(delta)
    return total / actions.size
