"""A critic that is linear in the belief: Bayesian regression with a hierarchical prior.

The value of a history is V(h_t) = b_t . w[c_t], with b_t a belief and c_t the history's cell, for
instance its last action and observation. A cell's weights have a Gaussian prior around the weights
that fit all cells together, so that rare cells borrow from the common ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.settings import check_entries


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


class Histories(NamedTuple):
    """What a critic sees of the histories of one agent.

    Attributes:
        before: (S, Z) belief before each action.
        final: (K, Z) belief after each episode's last observation.
        cells: of the same histories.
    """

    before: FloatArray
    final: FloatArray
    cells: Cells


class Critic(NamedTuple):
    """What the critic has learned of C cells.

    Attributes:
        weights: (C, Z) the value's weights, posterior means.
        precision: (C, Z, Z) evidence: fading sum of b b'.
        moment: (C, Z) fading sum of b y, y the targets.
    """

    weights: FloatArray
    precision: FloatArray
    moment: FloatArray

    @staticmethod
    def begin(n_cells: int, n_nodes: int) -> Critic:
        """No evidence: every value is 0.

        Raises:
            ValueError: a table would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
        """
        check_entries("critic", n_cells, n_nodes, n_nodes)
        return Critic(
            np.zeros((n_cells, n_nodes)),
            np.zeros((n_cells, n_nodes, n_nodes)),
            np.zeros((n_cells, n_nodes)),
        )

    def values(self, histories: Histories) -> tuple[FloatArray, FloatArray]:
        """V before each action (S,) and after each episode's last observation (K,)."""
        before, final, cells = histories
        return (
            np.einsum("sz,sz->s", before, self.weights[cells.before]),
            np.einsum("kz,kz->k", final, self.weights[cells.final]),
        )

    def fitted(
        self, histories: Histories, targets: FloatArray, memory: float, ridge: float
    ) -> Critic:
        """The critic after the evidence of new steps.

        w[c] = (P[c] + ridge I)^-1 (m[c] + ridge w0) with w0 the same fit of all cells together
        around 0. A single cell has none to borrow from, and w0 is 0.

        Args:
            histories: S of them, before the actions.
            targets: (S,) their returns.
            memory: share of the old evidence that is kept, in [0, 1].
            ridge: precision of the prior, in steps, positive.
        """
        precision, moment = memory * self.precision, memory * self.moment
        for cell in np.unique(histories.cells.before):
            here = histories.cells.before == cell
            belief = histories.before[here]
            precision[cell] += belief.T @ belief
            moment[cell] += belief.T @ targets[here]
        nothing = np.zeros(moment.shape[1])
        shared = _posterior_mean(precision.sum(axis=0), moment.sum(axis=0), ridge, nothing)
        around = shared if len(moment) > 1 else nothing
        return Critic(_posterior_mean(precision, moment, ridge, around), precision, moment)

    def divided(self, node: int, place: int) -> Critic:
        """The critic of beliefs in which a place, its own belief dropped, takes half of a node's.

        Args:
            node: whose belief is halved.
            place: another, which holds the other half.
        """
        halves = np.eye(self.weights.shape[1])
        halves[place] = 0.0
        halves[[node, place], node] = 0.5
        weights = self.weights.copy()
        weights[:, place] = weights[:, node]
        return Critic(weights, halves @ self.precision @ halves.T, self.moment @ halves.T)


def _posterior_mean(
    precision: FloatArray, moment: FloatArray, ridge: float, around: FloatArray
) -> FloatArray:
    """(P + ridge I)^-1 (m + ridge w0), of one cell or of many."""
    prior = ridge * np.eye(len(around))
    pulled = (moment + ridge * around)[..., None]
    return np.linalg.solve(precision + prior, pulled)[..., 0].astype(np.float64)
