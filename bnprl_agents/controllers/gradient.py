"""Exact gradients of action probabilities with respect to a controller's additive logits.

With b_t(i) = p(z_t = i | h_t) before the action, p(a | h_t) = sum_i b_t(i) pi(i, a), and
alpha_t(i) = b_t(i) pi(i, a_t) / p(a_t | h_t), the filter is

    b_{t+1}(j) = sum_i alpha_t(i) W[a_t, o_{t+1}, i, j],   W = move[a, i, j] sight[o, j] / norm.

The kernel runs it forward and its adjoint backward, O(Z^2) a step. It never forms the table W, so
that it stays in the processor's cache and its cost does not grow with A or O.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.controllers.additive import AdditiveLogits, Factors
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.proximal.config import clipped_pull
from bnprl_agents.softmax import softmax_gradient


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

    J = sum_t weight_t [min(r_t A_t, clip(r_t, 1 - clip, 1 + clip) A_t) + entropy H_t
    + sum_i b_t(i) bonus_i], where r_t = p(a_t | h_t) / exp(log_old_t) and H_t is the entropy of
    p(. | h_t).

    Attributes:
        advantage: (S,) A_t.
        log_old: (S,) logarithm of each action's probability before the update.
        weight: (S,) of each step.
        clip: largest useful change of a probability, relative.
        entropy: weight of the entropy.
        bonus: (Z,) what a step in each node earns.
    """

    advantage: FloatArray
    log_old: FloatArray
    weight: FloatArray
    clip: float
    entropy: float
    bonus: FloatArray


class Ascent(NamedTuple):
    """The gradient of a `Surrogate` on some episodes.

    Attributes:
        gradient: dJ/d logits.
        divergence: mean of r - 1 - log r, an estimate of the divergence from the old policy.
        entropy: mean entropy of the action distributions.
        steps: of these episodes.
    """

    gradient: AdditiveLogits
    divergence: float
    entropy: float
    steps: int


def filter_beliefs(episodes: EpisodeBatch, agent: int, factors: Factors) -> Beliefs:
    """Filter every episode of one agent."""
    return Beliefs(
        *_filter(
            episodes.offsets,
            np.ascontiguousarray(episodes.observations[:, agent]),
            np.ascontiguousarray(episodes.actions[:, agent]),
            np.ascontiguousarray(episodes.final_observations[:, agent]),
            factors,
        )
    )


def surrogate_gradient(
    episodes: EpisodeBatch,
    agent: int,
    factors: Factors,
    surrogate: Surrogate,
    chosen: IntArray,
) -> Ascent:
    """Gradient of the surrogate over the chosen episodes with respect to one agent's logits.

    Args:
        episodes: K episodes.
        agent: whose actions and observations.
        factors: its controller; no probability of an action taken is 0.
        surrogate: the objective, its arrays aligned with all S steps.
        chosen: indices of the episodes to sum over.
    """
    slope = AdditiveLogits(
        initial=np.zeros_like(factors.initial),
        action=np.zeros_like(factors.action),
        move=np.zeros_like(factors.move),
        sight=np.zeros_like(factors.sight),
    )
    divergence, entropy, steps = _ascent(
        chosen,
        episodes.offsets,
        np.ascontiguousarray(episodes.observations[:, agent]),
        np.ascontiguousarray(episodes.actions[:, agent]),
        factors,
        surrogate,
        slope,
    )
    gradient = slope._replace(
        initial=softmax_gradient(factors.initial, slope.initial),
        action=softmax_gradient(factors.action.T, slope.action.T),
    )
    return Ascent(gradient, divergence / steps, entropy / steps, steps)


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _condition(belief, chosen, alpha):  # type: ignore[no-untyped-def]
    """Set alpha_t from b_t and pi(., a_t); return p(a_t | h_t)."""
    total = 0.0
    for i in range(belief.size):
        alpha[i] = belief[i] * chosen[i]
        total += alpha[i]
    for i in range(belief.size):
        alpha[i] /= total
    return total


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _advance(alpha, move, sight, norm, ahead):  # type: ignore[no-untyped-def]
    """Set b_{t+1} from alpha_t."""
    ahead[:] = 0.0
    for i in range(alpha.size):
        weight = alpha[i] / norm[i]
        for j in range(alpha.size):
            ahead[j] += weight * move[i, j]
    for j in range(alpha.size):
        ahead[j] *= sight[j]


@njit(cache=True, error_model="numpy")
def _filter(offsets, observations, actions, final_seen, factors):  # type: ignore[no-untyped-def]
    n_nodes, n_episodes = factors.action.shape[1], offsets.size - 1
    belief, likelihood = np.empty((actions.size, n_nodes)), np.empty(actions.size)
    final, alpha = np.empty((n_episodes, n_nodes)), np.empty(n_nodes)
    for k in range(n_episodes):
        last = offsets[k + 1] - 1
        belief[offsets[k]] = factors.initial[observations[offsets[k]]]
        for t in range(offsets[k], last + 1):
            a, seen, ahead = actions[t], final_seen[k], final[k]
            if t < last:
                seen, ahead = observations[t + 1], belief[t + 1]
            likelihood[t] = _condition(belief[t], factors.action[a], alpha)
            _advance(alpha, factors.move[a], factors.sight[seen], factors.norm[a, seen], ahead)
    return belief, likelihood, final


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _retreat(alpha, move, sight, norm, ahead, back, d_move, d_sight):  # type: ignore[no-untyped-def]
    """Adjoint of `_advance`: set back = dJ/d alpha_t from ahead = dJ/d b_{t+1}.

    Adds dJ/d move and dJ/d sight (of the logits); returns the mean of back under alpha_t.
    """
    n_nodes, mean = alpha.size, 0.0
    seen, pull = np.empty(n_nodes), np.empty(n_nodes)
    for j in range(n_nodes):
        seen[j] = sight[j] * ahead[j]
    for i in range(n_nodes):
        total = 0.0
        for j in range(n_nodes):
            total += move[i, j] * seen[j]
        back[i] = total / norm[i]
        mean += alpha[i] * back[i]
        weight = alpha[i] / norm[i]
        for j in range(n_nodes):
            pull[j] = weight * move[i, j] * (seen[j] - back[i] * sight[j])
            d_move[i, j] += pull[j]
        for j in range(n_nodes):
            d_sight[j] += pull[j]
    return mean


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _choose(belief, action, push, d_action, back):  # type: ignore[no-untyped-def]
    """Entropy of p(. | h_t); adds `push` times its gradient to those of pi and of b_t."""
    entropy = 0.0
    for a in range(action.shape[0]):
        p = 0.0
        for i in range(belief.size):
            p += belief[i] * action[a, i]
        log_p = np.log(max(p, 1e-300))
        entropy -= p * log_p
        slope = -push * (log_p + 1.0)
        for i in range(belief.size):
            d_action[a, i] += belief[i] * slope
            back[i] += action[a, i] * slope
    return entropy


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _follow(observations, actions, factors, belief, alpha, likelihood):  # type: ignore[no-untyped-def]
    """Filter one episode: set b_t, alpha_t and p(a_t | h_t)."""
    belief[0] = factors.initial[observations[0]]
    for t in range(actions.size):
        a = actions[t]
        likelihood[t] = _condition(belief[t], factors.action[a], alpha[t])
        if t < actions.size - 1:
            o = observations[t + 1]
            _advance(alpha[t], factors.move[a], factors.sight[o], factors.norm[a, o], belief[t + 1])


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _gain(step, a, belief, likelihood, surrogate, factors, d_action, back, ahead):  # type: ignore[no-untyped-def]
    """Set ahead = dJ/d b_t from back = dJ/d alpha_t, centred; return r - 1 - log r and H_t."""
    weight = surrogate.weight[step]
    ratio = likelihood / np.exp(surrogate.log_old[step])
    pull = weight * clipped_pull(ratio, surrogate.advantage[step], surrogate.clip)
    for i in range(belief.size):
        change = (back[i] + pull) / likelihood
        d_action[a, i] += belief[i] * change
        ahead[i] = factors.action[a, i] * change + weight * surrogate.bonus[i]
    entropy = _choose(belief, factors.action, weight * surrogate.entropy, d_action, ahead)
    return ratio - 1.0 - np.log(ratio), entropy


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _ascent(chosen, offsets, observations, actions, factors, surrogate, slope):  # type: ignore[no-untyped-def]
    n_nodes = factors.action.shape[1]
    longest = (offsets[1:] - offsets[:-1])[chosen].max()
    belief, alpha = np.empty((longest + 1, n_nodes)), np.empty((longest, n_nodes))
    likelihood = np.empty(longest)
    back, ahead = np.empty(n_nodes), np.empty(n_nodes)  # dJ/d alpha_t, dJ/d b_{t+1}
    divergence, entropy, steps = 0.0, 0.0, 0
    for k in chosen:
        seen = observations[offsets[k] : offsets[k + 1]]
        done = actions[offsets[k] : offsets[k + 1]]
        _follow(seen, done, factors, belief, alpha, likelihood)
        for t in range(done.size - 1, -1, -1):
            a = done[t]
            back[:] = 0.0
            if t < done.size - 1:
                o = seen[t + 1]
                mean = _retreat(
                    alpha[t], factors.move[a], factors.sight[o], factors.norm[a, o], ahead, back,
                    slope.move[a], slope.sight[o],
                )  # fmt: skip
                back -= mean
            far, open_ = _gain(
                offsets[k] + t, a, belief[t], likelihood[t], surrogate, factors, slope.action,
                back, ahead,
            )  # fmt: skip
            divergence, entropy = divergence + far, entropy + open_
        slope.initial[seen[0]] += ahead
        steps += done.size
    return divergence, entropy, steps
