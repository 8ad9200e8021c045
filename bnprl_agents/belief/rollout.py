"""Compiled rollouts of a belief policy in a tabular model."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.belief.filtering import predict
from bnprl_agents.belief.policy import BeliefPolicy
from bnprl_agents.controllers.rollout import check_size, in_chunks
from bnprl_agents.episodes import EpisodeBatch
from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw


def belief_rollout(
    model: TabularModel,
    policy: BeliefPolicy,
    *,
    episodes: int,
    horizon: int,
    rng: np.random.Generator,
) -> EpisodeBatch:
    """Sample whole episodes; an episode ends in a terminal state or after `horizon` steps.

    Args:
        model: what is simulated, of one agent.
        policy: acts on its belief; the probabilities of its actions are recorded.
        episodes: K, at least 1.
        horizon: largest number of steps of an episode, at least 1.
        rng: source of every draw; it is advanced.

    Raises:
        ValueError: the policy does not fit the model, or a number is below 1.
    """
    sizes = (model.n_actions, model.n_observations + (not model.fully_observed))
    if model.n_agents != 1 or policy.sight.T.shape != sizes:
        raise ValueError(
            f"policy: {policy.sight.shape[1]} actions and {policy.sight.shape[0]} "
            f"observations, the model has {model.n_agents} agents and {sizes}"
        )
    check_size(episodes, horizon)
    parts = in_chunks(
        lambda chunk, stream: _rollout(model.sampler, policy, len(chunk), horizon, stream),
        episodes,
        rng,
    )
    return EpisodeBatch.concatenate([EpisodeBatch(*part) for part in parts])


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _choose(belief, action, sight, uniform):  # type: ignore[no-untyped-def]
    """Draw an action; return it with its probability."""
    logits = sight.copy()
    for i in range(belief.size):
        for u in range(logits.size):
            logits[u] += belief[i] * action[i, u]
    p = np.exp(logits - logits.max())
    p /= p.sum()
    chosen, passed = 0, p[0]
    while passed <= uniform and chosen < p.size - 1:
        chosen += 1
        passed += p[chosen]
    return chosen, min(p[chosen], 1.0)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _advance(filter_, belief, action, observation, ahead):  # type: ignore[no-untyped-def]
    seen = filter_.emission[observation]
    likelihood = predict(belief, filter_.transition[action], seen, ahead)
    belief[:] = ahead * seen / likelihood


@njit(cache=True, nogil=True)
def _step(sampler, state, action, rng):  # type: ignore[no-untyped-def]
    """Draw the next state and observation; return them with the reward."""
    move = draw(sampler.transition, action * sampler.n_states + state, rng.random())
    state = np.int64(sampler.transition.outcome[move])
    row = action * sampler.n_states + state
    seen = np.int64(sampler.observation.outcome[draw(sampler.observation, row, rng.random())])
    return state, seen, sampler.reward[move, seen % sampler.reward.shape[1]]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _rollout(sampler, policy, episodes, horizon, rng):  # type: ignore[no-untyped-def]
    capacity = episodes * horizon
    offsets = np.zeros(episodes + 1, dtype=np.int64)
    observations = np.empty((capacity, 1), dtype=np.int64)
    actions = np.empty((capacity, 1), dtype=np.int64)
    rewards, behaviour = np.empty(capacity), np.empty((capacity, 1))
    last_seen = np.empty((episodes, 1), dtype=np.int64)
    terminated = np.zeros(episodes, dtype=np.bool_)
    states = policy.model.initial.shape[1]
    belief, ahead = np.empty(policy.action.shape[0]), np.empty(policy.action.shape[0])
    step = 0
    for k in range(episodes):
        state = np.int64(sampler.start.outcome[draw(sampler.start, 0, rng.random())])
        seen = state if sampler.informative_start else sampler.n_observations
        belief[:states] = policy.model.initial[seen]
        belief[states:] = policy.memory.initial[seen]
        for t in range(horizon):
            a, p = _choose(belief, policy.action, policy.sight[seen], rng.random())
            observations[step, 0], actions[step, 0], behaviour[step, 0] = seen, a, p
            state, seen, rewards[step] = _step(sampler, state, a, rng)
            step += 1
            if sampler.terminal[state]:
                terminated[k] = True
                break
            if t + 1 < horizon:
                _advance(policy.model, belief[:states], a, seen, ahead[:states])
                _advance(policy.memory, belief[states:], a, seen, ahead[states:])
        last_seen[k] = seen
        offsets[k + 1] = step
    return (
        offsets,
        observations[:step],
        actions[:step],
        rewards[:step],
        behaviour[:step],
        last_seen,
        terminated,
    )
