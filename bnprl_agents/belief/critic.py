"""A critic that is linear in the belief, and the advantages it gives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.belief.filtering import Beliefs
from bnprl_agents.episodes import EpisodeBatch, FloatArray


class Critic(NamedTuple):
    """Bayesian linear regression of returns on beliefs, with a unit Gaussian prior.

    Attributes:
        weights: (Z,) value of each hidden state.
        precision: (Z, Z) evidence, a fading sum of b b'.
        moment: (Z,) fading sum of b y, y the returns.
    """

    weights: FloatArray
    precision: FloatArray
    moment: FloatArray

    @staticmethod
    def begin(n_states: int) -> Critic:
        """No evidence: every value is 0."""
        return Critic(np.zeros(n_states), np.zeros((n_states, n_states)), np.zeros(n_states))

    def fitted(self, belief: FloatArray, returns: FloatArray, keep: float) -> Critic:
        """Add evidence (S, Z), (S,) to the share `keep` of the old."""
        precision: FloatArray = keep * self.precision + belief.T @ belief
        moment: FloatArray = keep * self.moment + belief.T @ returns
        weights: FloatArray = np.linalg.solve(precision + np.eye(moment.size), moment)
        return Critic(weights, precision, moment)


def advantages(
    episodes: EpisodeBatch, beliefs: Beliefs, weights: FloatArray, discount: float, decay: float
) -> FloatArray:
    """Generalised advantage estimates (S,) (Schulman et al., ICLR 2016).

    A_t = delta_t + discount decay A_{t+1}, delta_t = r_t + discount V_{t+1} - V_t; a truncated
    episode goes on at the value of its last belief, nothing follows a terminal state.
    """
    estimates: FloatArray = _advantages(
        episodes.offsets,
        episodes.rewards,
        beliefs.before @ weights,
        np.where(episodes.terminated, 0.0, beliefs.final @ weights),
        discount,
        discount * decay,
    )
    return estimates


@njit(cache=True)
def _advantages(offsets, rewards, values, final, discount, trace):  # type: ignore[no-untyped-def]
    advantage = np.empty(rewards.size)
    for k in range(final.size):
        after, later = final[k], 0.0
        for t in range(offsets[k + 1] - 1, offsets[k] - 1, -1):
            later = rewards[t] + discount * after - values[t] + trace * later
            advantage[t] = later
            after = values[t]
    return advantage
