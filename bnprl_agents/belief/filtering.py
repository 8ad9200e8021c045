"""The compiled filter, and the gradient through it, in time linear in the steps.

With f_t the belief, m_{t+1}(j) = sum_i f_t(i) T[a_t, i, j] E[o_{t+1}, j] and the likelihood of an
observation c_{t+1} = sum_j m_{t+1}(j), the belief f_{t+1} = m_{t+1} / c_{t+1}. For an objective
sum_t J_t(f_t) + w log c_t the gradient G_t by f_t obeys the backward recursion

    dm_{t+1}(j) = (G_{t+1}(j) - G_{t+1} . f_{t+1} + w) / c_{t+1}
    G_t(i)      = dJ_t / df_t(i) + sum_j T[a_t, i, j] E[o_{t+1}, j] dm_{t+1}(j)

With J = 0 its sums are the expected counts of Baum and Welch (Fisher's identity), so the same pass
learns the model by maximum likelihood and the policy by its advantages.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.belief.policy import Filter, FilterLogits
from bnprl_agents.episodes import BoolArray, EpisodeBatch, FloatArray, IntArray
from bnprl_agents.softmax import softmax_gradient

NEGLIGIBLE = 1e-5
"""Belief below which a state's row is skipped."""


class Sequences(NamedTuple):
    """What a filter sees of K episodes of one agent, S steps in all.

    Attributes:
        offsets: (K + 1,) row at which each episode begins.
        observations: (S,) before each action.
        actions: (S,).
        after: (S,) observation after each action.
        terminated: (K,).
        rewards: (S,) after each action; filters do not see them.
    """

    offsets: IntArray
    observations: IntArray
    actions: IntArray
    after: IntArray
    terminated: BoolArray
    rewards: FloatArray

    @staticmethod
    def of(episodes: EpisodeBatch) -> Sequences:
        """Those of a batch of the only agent."""
        seen, actions = episodes.observations[:, 0], episodes.actions[:, 0]
        after = np.roll(seen, -1)
        after[episodes.offsets[1:] - 1] = episodes.final_observations[:, 0]
        return Sequences(
            episodes.offsets, seen, actions, after, episodes.terminated, episodes.rewards
        )

    def chosen(self, episodes: IntArray) -> tuple[Sequences, IntArray]:
        """Some of the episodes, and the rows of their steps."""
        lengths = np.diff(self.offsets)[episodes]
        ends = np.cumsum(lengths)
        rows = np.arange(ends[-1]) + np.repeat(self.offsets[episodes] - ends + lengths, lengths)
        return Sequences(
            np.concatenate([[0], ends]),
            self.observations[rows],
            self.actions[rows],
            self.after[rows],
            self.terminated[episodes],
            self.rewards[rows],
        ), rows


class Filtered(NamedTuple):
    """A filter's way through `Sequences`.

    Attributes:
        before: (S, Z) belief before each action.
        ahead: (S, Z) p(z' | h, a); not set where the episode ends.
        likelihood: (S,) probability of what followed each action: an observation or the end.
        final: (K, Z) belief after the last observation; 0 after a terminal state.
    """

    before: FloatArray
    ahead: FloatArray
    likelihood: FloatArray
    final: FloatArray


def run_filter(sequences: Sequences, filter_: Filter) -> Filtered:
    """Filter every episode."""
    return Filtered(*_forward(sequences, filter_))


def filter_gradient(
    sequences: Sequences,
    filter_: Filter,
    filtered: Filtered,
    slope: FloatArray,
    prediction: float,
) -> FilterLogits:
    """Gradient of sum_t J_t(f_t) + prediction * log-likelihood by the filter's logits.

    Args:
        sequences: K episodes of S steps.
        filter_: where.
        filtered: its way through them.
        slope: (S, Z) dJ_t / df_t.
        prediction: weight of the log-likelihood of observations and ends.
    """
    initial, moves, emission = _backward(sequences, filter_, filtered, slope, prediction)
    shares = np.concatenate([filter_.transition, filter_.termination[..., None]], axis=-1)
    return FilterLogits(
        softmax_gradient(filter_.initial, initial),
        softmax_gradient(shares, moves),
        softmax_gradient(filter_.emission.T, emission.T),
    )


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def predict(belief, move, emission, ahead):  # type: ignore[no-untyped-def]
    """Write p(z' | h, a) to `ahead`; return the likelihood of the observation."""
    ahead[:] = 0.0
    for i in range(belief.size):
        weight = belief[i]
        if weight > NEGLIGIBLE:
            for j in range(belief.size):
                ahead[j] += weight * move[i, j]
    likelihood = 0.0
    for j in range(belief.size):
        likelihood += ahead[j] * emission[j]
    return likelihood


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _forward(sequences, filter_):  # type: ignore[no-untyped-def]
    offsets, observations, actions, after, terminated, _ = sequences
    n_states = filter_.initial.shape[1]
    before, ahead = np.zeros((actions.size, n_states)), np.zeros((actions.size, n_states))
    likelihood, final = np.zeros(actions.size), np.zeros((terminated.size, n_states))
    belief = np.empty(n_states)
    for k in range(terminated.size):
        belief[:] = filter_.initial[observations[offsets[k]]]
        for t in range(offsets[k], offsets[k + 1]):
            a, before[t] = actions[t], belief
            if t + 1 == offsets[k + 1] and terminated[k]:
                likelihood[t] = (belief * filter_.termination[a]).sum()
            else:
                seen = filter_.emission[after[t]]
                likelihood[t] = predict(belief, filter_.transition[a], seen, ahead[t])
                belief[:] = ahead[t] * seen / likelihood[t]
        if not terminated[k]:
            final[k] = belief
    return before, ahead, likelihood, final


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _backward(sequences, filter_, filtered, slope, prediction):  # type: ignore[no-untyped-def]
    offsets, observations, actions, after, terminated, _ = sequences
    d_initial, d_emission = np.zeros(filter_.initial.shape), np.zeros(filter_.emission.shape)
    n_actions, n_states = filter_.termination.shape
    d_moves = np.zeros((n_actions, n_states, n_states + 1))
    future, message = np.empty(n_states), np.empty(n_states)
    for k in range(terminated.size):
        future[:] = 0.0
        for t in range(offsets[k + 1] - 1, offsets[k] - 1, -1):
            a, c, belief = actions[t], filtered.likelihood[t], filtered.before[t]
            if t + 1 == offsets[k + 1] and terminated[k]:
                d_moves[a, :, n_states] += prediction * belief / c
                future[:] = prediction * filter_.termination[a] / c
            else:
                seen, ahead = filter_.emission[after[t]], filtered.ahead[t]
                mean = (future * ahead * seen).sum() / c
                message[:] = (future - mean + prediction) / c
                d_emission[after[t]] += ahead * message
                message *= seen
                _back(belief, filter_.transition[a], message, d_moves[a], future)
            future += slope[t]
        d_initial[observations[offsets[k]]] += future
    return d_initial, d_moves, d_emission


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _back(belief, move, message, d_move, future):  # type: ignore[no-untyped-def]
    """Overwrite the gradient by the next belief with the one by this belief."""
    for i in range(belief.size):
        total, weight = 0.0, belief[i]
        if weight > NEGLIGIBLE:
            for j in range(belief.size):
                total += move[i, j] * message[j]
                d_move[i, j] += weight * message[j]
        future[i] = total
