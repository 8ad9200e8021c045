"""Compiled rollouts: tabular model and controllers are sampled together, episode after episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
from numba import get_num_threads, njit

from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw

T = TypeVar("T")

CHUNK = 64
"""Episodes of one random stream."""


class Team(NamedTuple):
    """Controllers of N agents padded to common sizes, as the kernel reads them.

    Attributes:
        action_sizes: (N,) actions of each agent.
        observation_sizes: (N,) observations of each agent, the null observation not counted.
        node_sizes: (N,) nodes of each agent.
        initial: (N, O, Z); action: (N, A, Z); successor: (N, A, O, Z, Z).
        explore: (N, Z) probability of a uniformly random action in each node.
    """

    action_sizes: IntArray
    observation_sizes: IntArray
    node_sizes: IntArray
    initial: FloatArray
    action: FloatArray
    successor: FloatArray
    explore: FloatArray


def rollout(
    model: TabularModel,
    controllers: Controller | Sequence[Controller],
    *,
    episodes: int,
    horizon: int,
    rng: np.random.Generator,
    explore: Sequence[FloatArray] | None = None,
) -> EpisodeBatch:
    """Sample whole episodes; an episode ends in a terminal state or after `horizon` steps.

    Acting filters the node distribution, sections 2.42-2.43, and mixes in uniform actions with
    probability sum_z p(z | h) explore[z], (2.46); the probabilities used are recorded.

    Args:
        model: what is simulated.
        controllers: one for each agent; a single one is a team of one.
        episodes: K, at least 1.
        horizon: largest number of steps of an episode, at least 1.
        rng: source of every draw; it is advanced.
        explore: for each agent (Z,), the probability of exploring in each node. None: never.

    Raises:
        ValueError: the controllers do not fit the model, or a number is below 1.
    """
    team = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    check_fit(model, team)
    check_size(episodes, horizon)
    padded = _padded(model, team, explore)
    parts = in_chunks(
        lambda size, stream: _rollout(model.sampler, padded, size, horizon, stream),
        episodes,
        rng,
    )
    return EpisodeBatch.concatenate([EpisodeBatch(*part) for part in parts])


def in_chunks(
    simulate: Callable[[int, np.random.Generator], T],
    episodes: int,
    rng: np.random.Generator,
) -> list[T]:
    """Simulate chunks of episodes, in as many threads as numba is allowed (NUMBA_NUM_THREADS).

    Each chunk has a random stream of its own, so that the threads do not change the result.

    Args:
        simulate: (number of episodes, random stream) -> result; releases the interpreter's lock.
        episodes: of all chunks, at least 1.
        rng: source of the chunks' seeds; it is advanced.
    """
    sizes = np.diff(np.append(np.arange(0, episodes, CHUNK), episodes)).tolist()
    streams = [np.random.default_rng(seed) for seed in rng.integers(2**63, size=len(sizes))]
    with ThreadPoolExecutor(get_num_threads()) as pool:
        return list(pool.map(simulate, sizes, streams))


def check_fit(model: TabularModel, team: Sequence[Controller]) -> None:
    """Check that each agent's controller has the model's actions and observations.

    Raises:
        ValueError: says which agent does not fit.
    """
    if len(team) != model.n_agents:
        raise ValueError(f"{len(team)} controllers for {model.n_agents} agents")
    null = 0 if model.fully_observed else 1
    for n, controller in enumerate(team):
        wanted = (model.action_sizes[n], model.observation_sizes[n] + null)
        if (controller.n_actions, controller.n_observations) != wanted:
            raise ValueError(
                f"controller of agent {n}: {controller.n_actions} actions and "
                f"{controller.n_observations} observations, the model has {wanted[0]} and "
                f"{wanted[1]} (the null observation included)"
            )


def check_size(episodes: int, horizon: int) -> None:
    """Check the size of a simulation.

    Raises:
        ValueError: a number is below 1.
    """
    if episodes < 1 or horizon < 1:
        raise ValueError(f"episodes: {episodes}, horizon: {horizon}, both must be at least 1")


def _padded(
    model: TabularModel, team: Sequence[Controller], explore: Sequence[FloatArray] | None
) -> Team:
    n_nodes = max(c.n_nodes for c in team)
    n_actions = max(c.n_actions for c in team)
    n_seen = max(c.n_observations for c in team)
    padded = Team(
        action_sizes=np.array(model.action_sizes),
        observation_sizes=np.array(model.observation_sizes),
        node_sizes=np.array([c.n_nodes for c in team]),
        initial=np.zeros((len(team), n_seen, n_nodes)),
        action=np.zeros((len(team), n_actions, n_nodes)),
        successor=np.zeros((len(team), n_actions, n_seen, n_nodes, n_nodes)),
        explore=np.zeros((len(team), n_nodes)),
    )
    for n, c in enumerate(team):
        padded.initial[n, : c.n_observations, : c.n_nodes] = normalised(c.initial)
        padded.action[n, : c.n_actions, : c.n_nodes] = c.action.T
        padded.successor[n, : c.n_actions, : c.n_observations, : c.n_nodes, : c.n_nodes] = (
            c.successor
        )
        if explore is not None:
            padded.explore[n, : c.n_nodes] = explore[n]
    return padded


@njit(cache=True, inline="always")
def _choose(belief, explore, action, uniform):  # type: ignore[no-untyped-def]
    """Draw an action for a node distribution; return it with its behaviour probability."""
    n_actions, n_nodes = action.shape
    exploring = 0.0
    for i in range(n_nodes):
        exploring += belief[i] * explore[i]
    chosen, probability, passed = 0, 0.0, 0.0
    for a in range(n_actions):
        exploiting = 0.0
        for i in range(n_nodes):
            exploiting += belief[i] * action[a, i]
        p = (1.0 - exploring) * exploiting + exploring / n_actions
        if p > 0.0:
            chosen, probability = a, min(p, 1.0)
            passed += p
            if uniform < passed:
                break
    return chosen, probability


@njit(cache=True, inline="always")
def _filter(belief, ahead, action, move):  # type: ignore[no-untyped-def]
    """Overwrite the node distribution by the one after an action and an observation."""
    n_nodes = belief.size
    ahead[:] = 0.0
    for i in range(n_nodes):
        weight = belief[i] * action[i]
        if weight > 0.0:
            for j in range(n_nodes):
                ahead[j] += weight * move[i, j]
    total = 0.0
    for j in range(n_nodes):
        total += ahead[j]
    for j in range(n_nodes):
        belief[j] = ahead[j] / total if total > 0.0 else 1.0 / n_nodes


@njit(cache=True, inline="always")
def split_joint(joint, sizes, parts):  # type: ignore[no-untyped-def]
    """Decode a joint index, the first agent most significant."""
    for n in range(sizes.size - 1, -1, -1):
        parts[n] = joint % sizes[n]
        joint //= sizes[n]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _rollout(sampler, team, episodes, horizon, rng):  # type: ignore[no-untyped-def]
    n_agents, n_nodes = team.explore.shape
    capacity = episodes * horizon
    offsets = np.zeros(episodes + 1, dtype=np.int64)
    observations = np.empty((capacity, n_agents), dtype=np.int64)
    actions = np.empty((capacity, n_agents), dtype=np.int64)
    rewards = np.empty(capacity)
    behaviour = np.empty((capacity, n_agents))
    last_seen = np.empty((episodes, n_agents), dtype=np.int64)
    terminated = np.zeros(episodes, dtype=np.bool_)
    beliefs = np.empty((n_agents, n_nodes))
    ahead = np.empty(n_nodes)
    seen = np.empty(n_agents, dtype=np.int64)
    step = 0
    for k in range(episodes):
        state = sampler.start.outcome[draw(sampler.start, 0, rng.random())]
        for n in range(n_agents):
            size = team.node_sizes[n]
            seen[n] = state if sampler.informative_start else team.observation_sizes[n]
            beliefs[n, :size] = team.initial[n, seen[n], :size]
        for t in range(horizon):
            joint = 0
            for n in range(n_agents):
                observations[step, n] = seen[n]
                size = team.node_sizes[n]
                a, p = _choose(
                    beliefs[n, :size],
                    team.explore[n, :size],
                    team.action[n, : team.action_sizes[n], :size],
                    rng.random(),
                )
                actions[step, n], behaviour[step, n] = a, p
                joint = joint * team.action_sizes[n] + a
            move = draw(sampler.transition, joint * sampler.n_states + state, rng.random())
            state = sampler.transition.outcome[move]
            sight = sampler.observation.outcome[
                draw(sampler.observation, joint * sampler.n_states + state, rng.random())
            ]
            rewards[step] = sampler.reward[move, sight % sampler.reward.shape[1]]
            split_joint(sight, team.observation_sizes, seen)
            step += 1
            if sampler.terminal[state]:
                terminated[k] = True
                break
            if t + 1 < horizon:
                for n in range(n_agents):
                    size, a = team.node_sizes[n], actions[step - 1, n]
                    _filter(
                        beliefs[n, :size],
                        ahead[:size],
                        team.action[n, a, :size],
                        team.successor[n, a, seen[n]],
                    )
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
