"""Gradient of policy objective and predictive likelihood through the belief, in linear time.

With f_t the belief, m_{t+1}(j) = sum_i f_t(i) T[a_t, i, j] E[j, o_{t+1}] and the likelihood of an
observation c_{t+1} = sum_j m_{t+1}(j), the belief f_{t+1} = m_{t+1} / c_{t+1}. For an objective
sum_t J_t(f_t) + w log c_t the gradient G_t by f_t obeys the backward recursion

    dm_{t+1}(j) = (G_{t+1}(j) - G_{t+1} . f_{t+1} + w) / c_{t+1}
    G_t(i)      = dJ_t / df_t(i) + sum_j T[a_t, i, j] E[j, o_{t+1}] dm_{t+1}(j)

With J = 0 its sums are the expected counts of Baum and Welch (Fisher's identity), so the same pass
learns the model by maximum likelihood and the policy by its advantages.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.belief.filtering import (
    NEGLIGIBLE,
    action_probabilities,
    next_observations,
    predict,
)
from bnprl_agents.belief.policy import Logits
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.proximal.config import clipped_pull
from bnprl_agents.softmax import softmax, softmax_gradient


class Surrogate(NamedTuple):
    """The clipped objective of proximal policy optimisation (Schulman et al. 2017, (7)).

    Attributes:
        advantage: (S,) of the actions taken.
        behaviour: (S,) probability with which each was chosen.
        clip: share by which a probability may change before the step stops counting.
        entropy: weight of the policy's entropy.
    """

    advantage: FloatArray
    behaviour: FloatArray
    clip: float
    entropy: float


NO_POLICY = Surrogate(np.zeros(0), np.zeros(0), 0.0, 0.0)
"""Of the likelihood alone."""


def objective_gradient(
    episodes: EpisodeBatch,
    chosen: IntArray,
    logits: Logits,
    surrogate: Surrogate,
    prediction: float,
) -> tuple[float, Logits]:
    """Gradient of surrogate + prediction * log-likelihood, a mean over the steps.

    Args:
        episodes: of one agent.
        chosen: indices of the episodes to use.
        logits: where.
        surrogate: the policy's objective; `NO_POLICY` for none.
        prediction: weight of the log-likelihood of observations and ends.

    Returns:
        Log-likelihood a step, and the gradient.
    """
    policy = logits.policy()
    log_likelihood, steps, initial, transition, termination, emission, action = _gradient(
        episodes.offsets,
        episodes.observations[:, 0],
        episodes.actions[:, 0],
        next_observations(episodes),
        episodes.terminated,
        chosen,
        policy.initial,
        policy.transition,
        policy.termination,
        np.ascontiguousarray(policy.emission.T),
        np.ascontiguousarray(policy.action.T),
        *surrogate,
        prediction,
    )
    moves = np.concatenate([transition, termination[..., None]], axis=-1)
    gradient = Logits(
        softmax_gradient(policy.initial, initial),
        softmax_gradient(softmax(logits.transition), moves),
        softmax_gradient(policy.emission, emission.T),
        np.ascontiguousarray(action.T),
    )
    return log_likelihood / steps, Logits(*(part / steps for part in gradient))


LARGEST_PULL = 10.0
"""Bound of an importance ratio times advantage."""


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _policy_step(belief, action, a, advantage, behaviour, clip, entropy, slope, local):  # type: ignore[no-untyped-def]
    """Add the surrogate's gradient by the action logits to `slope`, write that by the belief."""
    n_actions, n_states = action.shape
    p = action_probabilities(belief, action)
    log_p = np.log(np.maximum(p, 1e-300))
    mean_entropy = -(p * log_p).sum()
    pull = clipped_pull(p[a] / behaviour, advantage, clip)
    weight = min(max(pull, -LARGEST_PULL), LARGEST_PULL)
    local[:] = 0.0
    for u in range(n_actions):
        taken = 1.0 if u == a else 0.0
        d = weight * (taken - p[u]) - entropy * p[u] * (log_p[u] + mean_entropy)
        for i in range(n_states):
            slope[u, i] += belief[i] * d
            local[i] += action[u, i] * d


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _gradient(  # type: ignore[no-untyped-def]
    offsets,
    observations,
    actions,
    after,
    terminated,
    chosen,
    initial,
    transition,
    termination,
    emission,
    action,
    advantage,
    behaviour,
    clip,
    entropy,
    prediction,
):
    n_states = action.shape[1]
    d_initial, d_transition = np.zeros(initial.shape), np.zeros(transition.shape)
    d_termination, d_emission = np.zeros(termination.shape), np.zeros(emission.shape)
    d_action = np.zeros(action.shape)
    longest = 0
    for k in chosen:
        longest = max(longest, offsets[k + 1] - offsets[k])
    belief, ahead = np.zeros((longest + 1, n_states)), np.zeros((longest + 1, n_states))
    local, likelihood = np.zeros((longest, n_states)), np.zeros(longest + 1)
    future, message = np.empty(n_states), np.empty(n_states)
    log_likelihood, steps = 0.0, 0
    for k in chosen:
        begin, length = offsets[k], offsets[k + 1] - offsets[k]
        steps += length
        belief[0] = initial[observations[begin]]
        for t in range(length):
            s = begin + t
            a = actions[s]
            if advantage.size:
                _policy_step(
                    belief[t], action, a, advantage[s], behaviour[s], clip, entropy,
                    d_action, local[t],
                )  # fmt: skip
            if t == length - 1 and terminated[k]:
                c = (belief[t] * termination[a]).sum()
            else:
                c = predict(belief[t], transition[a], emission[after[s]], ahead[t + 1])
                belief[t + 1] = ahead[t + 1] * emission[after[s]] / c
            likelihood[t + 1] = c
            log_likelihood += np.log(c)
        future[:] = 0.0
        for t in range(length - 1, -1, -1):
            a, c = actions[begin + t], likelihood[t + 1]
            if t == length - 1 and terminated[k]:
                d_termination[a] += prediction * belief[t] / c
                future[:] = prediction * termination[a] / c
            else:
                o = after[begin + t]
                message[:] = (future - (future * belief[t + 1]).sum() + prediction) / c
                d_emission[o] += ahead[t + 1] * message
                message *= emission[o]
                _back(belief[t], transition[a], message, d_transition[a], future)
            if advantage.size:
                future += local[t]
        d_initial[observations[begin]] += future
    return log_likelihood, steps, d_initial, d_transition, d_termination, d_emission, d_action


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _back(belief, move, message, d_move, future):  # type: ignore[no-untyped-def]
    """Overwrite the gradient by the next belief with the one by this belief."""
    for i in range(belief.size):
        total, weight = 0.0, belief[i]
        for j in range(belief.size):
            total += move[i, j] * message[j]
        future[i] = total
        if weight > NEGLIGIBLE:
            for j in range(belief.size):
                d_move[i, j] += weight * message[j]
