"""A critic on the node belief: Bayesian linear regression with a hierarchical prior.

The value of a history is linear in the belief, with weights that depend on the history's cell,
its last action and observation: V(h_t) = b_t . w[cell_t]. A cell's weights have a Gaussian prior
around the weights that fit all cells together, so that rare cells borrow from the common ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.controllers.gradient import Beliefs
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray


class Cells(NamedTuple):
    """Cells of the histories of one agent: before each action (S,), and at each end (K,)."""

    before: IntArray
    final: IntArray


def history_cells(episodes: EpisodeBatch, agent: int, n_actions: int, n_observations: int) -> Cells:
    """(last action, observation) as one index in [0, (A + 1) O); no action yet counts as A."""
    actions = episodes.actions[:, agent]
    last = np.roll(actions, 1)
    last[episodes.offsets[:-1]] = n_actions
    return Cells(
        before=last * n_observations + episodes.observations[:, agent],
        final=actions[episodes.offsets[1:] - 1] * n_observations
        + episodes.final_observations[:, agent],
    )


class Critic(NamedTuple):
    """What the critic has learned of C cells.

    Attributes:
        weights: (C, Z) the value's weights, posterior means.
        precision: (C, Z, Z) evidence: discounted sum of b b'.
        moment: (C, Z) discounted sum of b y, y the targets.
    """

    weights: FloatArray
    precision: FloatArray
    moment: FloatArray

    @staticmethod
    def begin(n_cells: int, n_nodes: int) -> Critic:
        """No evidence: every value is 0."""
        return Critic(
            np.zeros((n_cells, n_nodes)),
            np.zeros((n_cells, n_nodes, n_nodes)),
            np.zeros((n_cells, n_nodes)),
        )

    def values(self, beliefs: Beliefs, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """V before each action (S,) and after each episode's last observation (K,)."""
        before = np.einsum("sz,sz->s", beliefs.belief, self.weights[cells.before])
        return before, np.einsum("kz,kz->k", beliefs.final, self.weights[cells.final])

    def fitted(
        self, belief: FloatArray, cells: IntArray, targets: FloatArray, keep: float, ridge: float
    ) -> Critic:
        """The critic after the evidence of new steps.

        w[c] = (P[c] + ridge I)^-1 (m[c] + ridge w0) with w0 the same fit of all cells together.

        Args:
            belief: (S, Z) features.
            cells: (S,) of the same histories.
            targets: (S,) their returns.
            keep: share of the old evidence that is kept, in [0, 1].
            ridge: precision of the prior, in steps, positive.
        """
        precision, moment = keep * self.precision, keep * self.moment
        _gather(belief, cells, targets, precision, moment)
        prior = ridge * np.eye(belief.shape[1])
        common = np.linalg.solve(precision.sum(axis=0) + prior, moment.sum(axis=0))
        pulled = (moment + ridge * common)[..., None]
        weights = np.linalg.solve(precision + prior, pulled)[..., 0].astype(np.float64)
        return Critic(weights, precision, moment)


def advantages(
    episodes: EpisodeBatch,
    values: tuple[FloatArray, FloatArray],
    discount: float,
    decay: float,
    ratio: FloatArray,
) -> FloatArray:
    """Generalised advantage estimates (Schulman et al., ICLR 2016), corrected off-policy.

    A_t = delta_t + discount decay min(1, ratio_{t+1}) A_{t+1},
    delta_t = r_t + discount V_{t+1} - V_t; nothing follows a terminal state, and a truncated
    episode goes on at the value of its last history.

    Args:
        episodes: K episodes.
        values: V before each action (S,), and at each end (K,).
        discount: factor in (0, 1].
        decay: lambda; 0 trusts the critic, 1 the returns.
        ratio: (S,) probability of each action under the policy, over that of the behaviour.
    """
    before, final = values
    after = np.where(episodes.terminated, 0.0, final)
    trace = discount * decay * np.minimum(ratio, 1.0)
    found: FloatArray = _advantages(
        episodes.offsets, episodes.rewards, before, after, discount, trace
    )
    return found


@njit(cache=True)
def _advantages(offsets, rewards, values, after, discount, trace):  # type: ignore[no-untyped-def]
    advantage = np.empty(rewards.size)
    for k in range(offsets.size - 1):
        last = offsets[k + 1] - 1
        advantage[last] = rewards[last] + discount * after[k] - values[last]
        for t in range(last - 1, offsets[k] - 1, -1):
            surprise = rewards[t] + discount * values[t + 1] - values[t]
            advantage[t] = surprise + trace[t + 1] * advantage[t + 1]
    return advantage


@njit(cache=True, fastmath={"reassoc", "contract"})
def _gather(belief, cells, targets, precision, moment):  # type: ignore[no-untyped-def]
    n_nodes = belief.shape[1]
    for t in range(cells.size):
        for i in range(n_nodes):
            moment[cells[t], i] += belief[t, i] * targets[t]
            for j in range(n_nodes):
                precision[cells[t], i, j] += belief[t, i] * belief[t, j]
