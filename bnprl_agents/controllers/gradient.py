"""Exact gradients through the node filter: how action probabilities depend on a controller.

With b_t(i) = p(z_t = i | h_t) before the action, p(a | h_t) = sum_i b_t(i) pi(i, a), and
alpha_t(i) = b_t(i) pi(i, a_t) / p(a_t | h_t), the filter is b_{t+1}(j) = sum_i alpha_t(i)
W[a_t, o_{t+1}, i, j]. The kernel runs it forward and its adjoint backward, O(Z^2) a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray


class Beliefs(NamedTuple):
    """What a controller believes along the episodes of one agent.

    Attributes:
        belief: (S, Z) node distribution before each action.
        likelihood: (S,) probability of each action given its history.
        final: (K, Z) node distribution after the last observation.
    """

    belief: FloatArray
    likelihood: FloatArray
    final: FloatArray


class Surrogate(NamedTuple):
    """The clipped objective of proximal policy optimisation with an entropy bonus.

    J = sum_t weight_t [min(r_t A_t, clip(r_t, 1 - clip, 1 + clip) A_t) + entropy H_t], where
    r_t = p(a_t | h_t) / exp(log_old_t) and H_t is the entropy of p(. | h_t).

    Attributes:
        advantage: (S,) A_t.
        log_old: (S,) logarithm of each action's probability before the update.
        weight: (S,) of each step.
        clip: largest useful change of a probability, relative.
        entropy: weight of the entropy.
    """

    advantage: FloatArray
    log_old: FloatArray
    weight: FloatArray
    clip: float
    entropy: float


class Ascent(NamedTuple):
    """The gradient of a `Surrogate` on some episodes, as if all table entries were free.

    Attributes:
        gradient: dJ/d initial, dJ/d action, dJ/d successor.
        divergence: mean of r - 1 - log r, an estimate of the divergence from the old policy.
        entropy: mean entropy of the action distributions.
        steps: of these episodes.
    """

    gradient: Counts
    divergence: float
    entropy: float
    steps: int


def filter_beliefs(episodes: EpisodeBatch, agent: int, controller: Controller) -> Beliefs:
    """Filter every episode of one agent; rows of the controller sum to 1."""
    return Beliefs(
        *_filter(
            episodes.offsets,
            np.ascontiguousarray(episodes.observations[:, agent]),
            np.ascontiguousarray(episodes.actions[:, agent]),
            np.ascontiguousarray(episodes.final_observations[:, agent]),
            controller.initial,
            np.ascontiguousarray(controller.action.T),
            controller.successor,
        )
    )


def surrogate_gradient(
    episodes: EpisodeBatch,
    agent: int,
    controller: Controller,
    surrogate: Surrogate,
    chosen: IntArray,
) -> Ascent:
    """Gradient of the surrogate over the chosen episodes with respect to one agent's tables.

    Args:
        episodes: K episodes.
        agent: whose actions and observations.
        controller: its controller; rows sum to 1, no probability of an action taken is 0.
        surrogate: the objective, its arrays aligned with all S steps.
        chosen: indices of the episodes to sum over.
    """
    initial, action = np.zeros_like(controller.initial), np.zeros(controller.action.T.shape)
    successor = np.zeros_like(controller.successor)
    divergence, entropy, steps = _ascent(
        chosen,
        episodes.offsets,
        np.ascontiguousarray(episodes.observations[:, agent]),
        np.ascontiguousarray(episodes.actions[:, agent]),
        controller.initial,
        np.ascontiguousarray(controller.action.T),
        controller.successor,
        surrogate,
        initial,
        action,
        successor,
    )
    gradient = Counts(initial, np.ascontiguousarray(action.T), successor)
    return Ascent(gradient, divergence / steps, entropy / steps, steps)


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _advance(belief, chosen, move, alpha, ahead):  # type: ignore[no-untyped-def]
    """Set alpha_t and b_{t+1} from b_t; return p(a_t | h_t)."""
    total = 0.0
    for i in range(belief.size):
        alpha[i] = belief[i] * chosen[i]
        total += alpha[i]
    ahead[:] = 0.0
    for i in range(belief.size):
        alpha[i] /= total
        for j in range(belief.size):
            ahead[j] += alpha[i] * move[i, j]
    return total


@njit(cache=True, error_model="numpy")
def _filter(offsets, observations, actions, final_seen, initial, action, successor):  # type: ignore[no-untyped-def]
    n_nodes, n_episodes = action.shape[1], offsets.size - 1
    belief, likelihood = np.empty((actions.size, n_nodes)), np.empty(actions.size)
    final, alpha = np.empty((n_episodes, n_nodes)), np.empty(n_nodes)
    for k in range(n_episodes):
        last = offsets[k + 1] - 1
        belief[offsets[k]] = initial[observations[offsets[k]]]
        for t in range(offsets[k], last + 1):
            seen, ahead = final_seen[k], final[k]
            if t < last:
                seen, ahead = observations[t + 1], belief[t + 1]
            a = actions[t]
            likelihood[t] = _advance(belief[t], action[a], successor[a, seen], alpha, ahead)
    return belief, likelihood, final


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _ascent(  # type: ignore[no-untyped-def]
    chosen,
    offsets,
    observations,
    actions,
    initial,
    action,
    successor,
    surrogate,
    d_initial,
    d_action,
    d_successor,
):
    n_actions, n_nodes = action.shape
    longest = 0
    for k in chosen:
        longest = max(longest, offsets[k + 1] - offsets[k])
    belief, alpha = np.empty((longest + 1, n_nodes)), np.empty((longest, n_nodes))
    likelihood, p = np.empty(longest), np.empty(n_actions)
    back, ahead = np.empty(n_nodes), np.empty(n_nodes)  # dJ/d alpha_t, dJ/d b_{t+1}
    divergence, entropy, steps = 0.0, 0.0, 0
    for k in chosen:
        begin, size = offsets[k], offsets[k + 1] - offsets[k]
        belief[0] = initial[observations[begin]]
        for t in range(size):
            a = actions[begin + t]
            seen = observations[begin + min(t + 1, size - 1)]
            likelihood[t] = _advance(
                belief[t], action[a], successor[a, seen], alpha[t], belief[t + 1]
            )
        ahead[:] = 0.0
        for t in range(size - 1, -1, -1):
            step, a = begin + t, actions[begin + t]
            mean = 0.0
            back[:] = 0.0
            if t < size - 1:
                move = successor[a, observations[step + 1]]
                d_move = d_successor[a, observations[step + 1]]
                for i in range(n_nodes):
                    for j in range(n_nodes):
                        back[i] += move[i, j] * ahead[j]
                        d_move[i, j] += alpha[t, i] * ahead[j]
                    mean += alpha[t, i] * back[i]
            ratio = likelihood[t] / np.exp(surrogate.log_old[step])
            divergence += ratio - 1.0 - np.log(ratio)
            pull = _clipped_pull(ratio, surrogate.advantage[step], surrogate.clip)
            pull *= surrogate.weight[step]  # dJ/d log p(a_t | h_t)
            for i in range(n_nodes):
                slope = (back[i] - mean + pull) / likelihood[t]
                d_action[a, i] += belief[t, i] * slope
                ahead[i] = action[a, i] * slope
            for b in range(n_actions):
                p[b] = 0.0
                for i in range(n_nodes):
                    p[b] += belief[t, i] * action[b, i]
                log_p = np.log(max(p[b], 1e-300))
                entropy -= p[b] * log_p
                slope = -surrogate.weight[step] * surrogate.entropy * (log_p + 1.0)
                for i in range(n_nodes):
                    d_action[b, i] += belief[t, i] * slope
                    ahead[i] += action[b, i] * slope
        for i in range(n_nodes):
            d_initial[observations[begin], i] += ahead[i]
        steps += size
    return divergence, entropy, steps


@njit(cache=True)
def _clipped_pull(ratio, advantage, clip):  # type: ignore[no-untyped-def]
    """Derivative of the clipped surrogate with respect to log p: 0 once the ratio has gone far."""
    far = ratio > 1.0 + clip if advantage > 0.0 else ratio < 1.0 - clip
    return 0.0 if far else ratio * advantage
