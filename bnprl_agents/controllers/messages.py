"""The E-step: forward and backward messages in time linear in the steps, whatever the rewards.

Notation: alpha_t(i) = p(z_t = i | a_{0:t}, o_{1:t}), c_t = p(a_t | h_t), nu_t the share of the
value that the reward at t contributes, Definition 13 and (4.1), (6.5). The dissertation sums
backward messages over every pair of times; the reward-weighted message

    B_T(i) = nu_T,   B_t(i) = nu_t + sum_j W[a_t, o_{t+1}, i, j] pi[j, a_{t+1}] B_{t+1}(j) / c_{t+1}

gives the same sums in one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, overload

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import EpisodeBatch, FloatArray, check_range


class Counts(NamedTuple):
    """Expected, value-weighted node counts of one agent, the sufficient statistics of (4.8).

    Attributes:
        initial: (O, Z) first nodes, by first observation; all entries sum to K.
        action: (Z, A) actions taken in nodes.
        successor: (A, O, Z, Z) moves from node to node.
    """

    initial: FloatArray
    action: FloatArray
    successor: FloatArray


class Messages(NamedTuple):
    """What the forward pass leaves behind for one agent.

    Attributes:
        alpha: (S, Z) filtered node distributions, given the actions so far.
        likelihood: (S,) c_t, the probability of each action given its history. From the first
            action on that the controller cannot take, both are 0.
    """

    alpha: FloatArray
    likelihood: FloatArray


@overload
def soft_counts(
    episodes: EpisodeBatch, controllers: Controller, discount: float
) -> tuple[float, Counts]: ...
@overload
def soft_counts(
    episodes: EpisodeBatch, controllers: Sequence[Controller], discount: float
) -> tuple[float, tuple[Counts, ...]]: ...
def soft_counts(
    episodes: EpisodeBatch, controllers: Controller | Sequence[Controller], discount: float
) -> tuple[float, Counts | tuple[Counts, ...]]:
    """Empirical value of the controllers and every agent's node counts; (2.45), (4.5)-(4.7).

    Time O(S Z^2) and memory O(S Z) an agent.

    Args:
        episodes: K episodes of N agents with their behaviour probabilities.
        controllers: one for each agent; a single one is a team of one and its counts come back
            bare.
        discount: factor in (0, 1].

    Returns:
        The value (importance-weighted mean return) and one `Counts` an agent. Where no episode
        has weight (every reward 0), the value is 0 and so are the counts.

    Raises:
        ValueError: a reward is negative, or the controllers do not fit the episodes.
    """
    if isinstance(controllers, Controller):
        value, counts = soft_counts(episodes, (controllers,), discount)
        return value, counts[0]
    if len(controllers) != episodes.n_agents:
        raise ValueError(f"{len(controllers)} controllers for {episodes.n_agents} agents")
    messages = [forward(episodes, n, controller) for n, controller in enumerate(controllers)]
    value, nu = reward_shares(episodes, [m.likelihood for m in messages], discount)
    counts = tuple(
        backward(episodes, n, controller, message, nu)
        for n, (controller, message) in enumerate(zip(controllers, messages, strict=True))
    )
    return value, counts


def forward(episodes: EpisodeBatch, agent: int, controller: Controller) -> Messages:
    """Filter every episode of one agent.

    Raises:
        ValueError: an action or observation lies outside the controller's tables.
    """
    check_range("actions", episodes.actions[:, agent], controller.n_actions)
    check_range("observations", episodes.observations[:, agent], controller.n_observations)
    alpha, likelihood = _forward(
        episodes.offsets,
        episodes.observations[:, agent],
        episodes.actions[:, agent],
        controller.initial,
        np.ascontiguousarray(controller.action.T),
        controller.successor,
    )
    return Messages(alpha, likelihood)


def reward_shares(
    episodes: EpisodeBatch, likelihoods: Sequence[FloatArray], discount: float
) -> tuple[float, FloatArray]:
    """The value V of (2.45) and nu_t = gamma^t r_t ratio_t / V of (4.1), (6.5), which sum to K.

    Args:
        episodes: K episodes.
        likelihoods: for each agent c_t, (S,).
        discount: factor in (0, 1].

    Returns:
        V and nu (S,). The weights are scaled by the largest ratio, so that nu is finite even
        where V overflows. Where V is 0, nu is 0.

    Raises:
        ValueError: a reward is negative.
    """
    weight, log_scale = reward_weights(episodes, likelihoods, discount)
    total = weight.sum()
    if total == 0.0:
        return 0.0, weight
    with np.errstate(over="ignore"):
        value = float(np.exp(log_scale) * total / episodes.n_episodes)
    return value, weight * (episodes.n_episodes / total)


def reward_weights(
    episodes: EpisodeBatch, likelihoods: Sequence[FloatArray], discount: float
) -> tuple[FloatArray, float]:
    """gamma^t r_t ratio_t as (S,) weights and the logarithm of their common scale.

    Raises:
        ValueError: a reward is negative.
    """
    if episodes.n_steps and episodes.rewards.min() < 0.0:
        raise ValueError(
            f"rewards: the smallest is {episodes.rewards.min()}, but this learner needs rewards "
            ">= 0; set reward_shift to the amount to add"
        )
    with np.errstate(divide="ignore"):
        log_step = sum(
            np.log(likelihood) - np.log(episodes.behaviour[:, n])
            for n, likelihood in enumerate(likelihoods)
        )
    log_weight = running_sum(episodes.offsets, np.asarray(log_step, dtype=np.float64))
    log_weight += np.log(discount) * episodes.steps_into_episode()
    earning = episodes.rewards > 0.0
    log_scale = float(np.max(log_weight, where=earning, initial=-np.inf))
    if log_scale == -np.inf:
        return np.zeros(episodes.n_steps), 0.0
    weight = np.zeros(episodes.n_steps)
    weight[earning] = episodes.rewards[earning] * np.exp(log_weight[earning] - log_scale)
    return weight, log_scale


def backward(
    episodes: EpisodeBatch,
    agent: int,
    controller: Controller,
    messages: Messages,
    nu: FloatArray,
) -> Counts:
    """Node counts of one agent from its forward messages and the reward shares nu (S,)."""
    initial, action, pairs = _backward(
        episodes.offsets,
        episodes.observations[:, agent],
        episodes.actions[:, agent],
        np.ascontiguousarray(controller.action.T),
        controller.successor,
        controller.n_observations,
        messages.alpha,
        messages.likelihood,
        nu,
    )
    return Counts(initial, np.ascontiguousarray(action.T), controller.successor * pairs)


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _forward(offsets, observations, actions, initial, action, successor):  # type: ignore[no-untyped-def]
    n_nodes = action.shape[1]
    alpha = np.zeros((observations.size, n_nodes))
    likelihood = np.zeros(observations.size)
    mass = np.empty(n_nodes)
    for k in range(offsets.size - 1):
        begin = offsets[k]
        mass[:] = initial[observations[begin]]
        for t in range(begin, offsets[k + 1]):
            if t > begin:
                move = successor[actions[t - 1], observations[t]]
                mass[:] = 0.0
                for i in range(n_nodes):
                    weight = alpha[t - 1, i]
                    if weight > 0.0:
                        for j in range(n_nodes):
                            mass[j] += weight * move[i, j]
            total = 0.0
            for j in range(n_nodes):
                mass[j] *= action[actions[t], j]
                total += mass[j]
            if total <= 0.0:
                break
            likelihood[t] = total
            for j in range(n_nodes):
                alpha[t, j] = mass[j] / total
    return alpha, likelihood


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _backward(  # type: ignore[no-untyped-def]
    offsets, observations, actions, action, successor, n_observations, alpha, likelihood, nu
):
    n_actions, n_nodes = action.shape
    initial_count = np.zeros((n_observations, n_nodes))
    action_count = np.zeros((n_actions, n_nodes))
    pairs = np.zeros(successor.shape)  # sum of alpha_t(i) m_{t+1}(j); times W it is omega
    future = np.empty(n_nodes)
    ahead = np.empty(n_nodes)
    for k in range(offsets.size - 1):
        begin, last = offsets[k], offsets[k + 1] - 1
        while last >= begin and likelihood[last] == 0.0:
            last -= 1
        if last < begin:
            continue
        future[:] = nu[last]
        for t in range(last, begin, -1):
            a = actions[t]
            for j in range(n_nodes):
                action_count[a, j] += alpha[t, j] * future[j]
                ahead[j] = action[a, j] * future[j] / likelihood[t]
            move = successor[actions[t - 1], observations[t]]
            pair = pairs[actions[t - 1], observations[t]]
            for i in range(n_nodes):
                weight = alpha[t - 1, i]
                total = nu[t - 1]
                if weight > 0.0:  # else nothing that the history allows depends on B(i)
                    for j in range(n_nodes):
                        pair[i, j] += weight * ahead[j]
                        total += move[i, j] * ahead[j]
                future[i] = total
        for j in range(n_nodes):
            count = alpha[begin, j] * future[j]
            action_count[actions[begin], j] += count
            initial_count[observations[begin], j] += count
    return initial_count, action_count, pairs


@njit(cache=True)
def running_sum(offsets, steps):  # type: ignore[no-untyped-def]
    """Sums (S,) of steps (S,) from each episode's beginning on."""
    sums = np.empty(steps.size)
    for k in range(offsets.size - 1):
        total = 0.0
        for t in range(offsets[k], offsets[k + 1]):
            total += steps[t]
            sums[t] = total
    return sums
