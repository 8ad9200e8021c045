"""Compiled rollouts: tabular model and controllers are sampled together, episode after episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from numba import get_num_threads, njit

from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.episodes import BoolArray, EpisodeBatch, FloatArray, IntArray
from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw

T = TypeVar("T")
RowArray = npt.NDArray[np.float32]

CHUNK = 64
"""Episodes of one random stream."""
VECTOR = 16
"""Filter rows are padded to multiples of this many entries, two registers of eight."""


class Team(NamedTuple):
    """Controllers of N agents as the kernel reads them, padded to common sizes.

    The kernel carries one *filter row* an agent, (C,) with C = Z + A + 2 and padding: the node
    distribution f, and what acting needs of it, which is linear in f:

        f(z),   sum_z f(z) pi(z, a),   sum_z f(z) explore(z),   sum_z f(z)

    so that one product with a row-augmented `successor` filters, prepares the next action and
    normalises. In single precision, which doubles the speed: the behaviour probabilities that are
    recorded are the ones that were drawn from.

    Attributes:
        action_sizes: (N,) actions of each agent.
        observation_sizes: (N,) observations of each agent, the null observation not counted.
        n_nodes: Z, the largest.
        n_actions: A, the largest.
        initial: (N, O, C) filter row after each first observation.
        advance: (N, A, O, Z, C) filter row after each action, observation and node before it;
            those of one action are scaled by 1 / max_z pi(z, a), so that no action underflows.
        lost: (N, C) filter row after a history that the controller cannot produce: uniform.
    """

    action_sizes: IntArray
    observation_sizes: IntArray
    n_nodes: int
    n_actions: int
    initial: RowArray
    advance: RowArray
    lost: RowArray


class Recording(NamedTuple):
    """Room for K episodes of at most H steps; a chunk's steps lie packed from its first row on.

    Memory is taken once, of the size that would do: pages that are never written cost nothing.

    Attributes:
        lengths: (K,) steps of each episode.
        observations, actions, behaviour: (K * H, N).
        rewards: (K * H,).
        last_seen: (K, N) final observations.
        terminated: (K,).
    """

    lengths: IntArray
    observations: IntArray
    actions: IntArray
    behaviour: FloatArray
    rewards: FloatArray
    last_seen: IntArray
    terminated: BoolArray


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

    Acting filters the node distribution, (2.43) and (2.44), and mixes in uniform actions with
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
    rows = _filter_rows(model, team, explore)
    record = _empty_recording(episodes, horizon, len(team))
    in_chunks(
        lambda chunk, stream: _rollout(
            model.sampler, rows, record, chunk.start, chunk.stop, horizon, stream
        ),
        episodes,
        rng,
    )
    return _packed(record, horizon)


def in_chunks(
    simulate: Callable[[range, np.random.Generator], T],
    episodes: int,
    rng: np.random.Generator,
) -> list[T]:
    """Simulate chunks of episodes, in as many threads as numba is allowed (NUMBA_NUM_THREADS).

    Each chunk has a random stream of its own, so that the threads do not change the result.

    Args:
        simulate: (episodes of the chunk, random stream) -> result; releases the interpreter's
            lock.
        episodes: of all chunks, at least 1.
        rng: source of the chunks' seeds; it is advanced.
    """
    chunks = _chunks(episodes)
    streams = [np.random.default_rng(seed) for seed in rng.integers(2**63, size=len(chunks))]
    with ThreadPoolExecutor(get_num_threads()) as pool:
        return list(pool.map(simulate, chunks, streams))


def _chunks(episodes: int) -> list[range]:
    return [range(k, min(k + CHUNK, episodes)) for k in range(0, episodes, CHUNK)]


def check_fit(model: TabularModel, team: Sequence[Controller]) -> None:
    """Check that each agent's controller has the model's actions and observations.

    Raises:
        ValueError: says which agent does not fit, or that the model is a fully observed one of
            several agents, of which each would have to see the state at the start.
    """
    if model.fully_observed and model.n_agents > 1:
        raise ValueError(
            f"a fully observed model of {model.n_agents} agents: controllers serve a single agent "
            "there; give the model its observations as a table"
        )
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


def _filter_rows(
    model: TabularModel, team: Sequence[Controller], explore: Sequence[FloatArray] | None
) -> Team:
    n_agents = len(team)
    n_nodes = max(c.n_nodes for c in team)
    n_actions = max(c.n_actions for c in team)
    n_seen = max(c.n_observations for c in team)
    width = -(-(n_nodes + n_actions + 2) // VECTOR) * VECTOR
    initial = np.zeros((n_agents, n_seen, width), np.float32)
    advance = np.zeros((n_agents, n_actions, n_seen, n_nodes, width), np.float32)
    lost = np.zeros((n_agents, width), np.float32)
    for n, c in enumerate(team):
        derived = np.zeros((c.n_nodes, width - n_nodes))  # node distribution -> the other columns
        derived[:, : c.n_actions] = c.action
        derived[:, n_actions] = 0.0 if explore is None else explore[n]
        derived[:, n_actions + 1] = 1.0
        likely = c.action / np.maximum(c.action.max(axis=0), np.finfo(np.float64).tiny)
        moves = likely.T[:, None, :, None] * c.successor
        uniform = np.full(c.n_nodes, 1.0 / c.n_nodes)
        for rows, nodes in (
            (initial[n, : c.n_observations], normalised(c.initial)),
            (advance[n, : c.n_actions, : c.n_observations, : c.n_nodes], moves),
            (lost[n], uniform),
        ):
            rows[..., : c.n_nodes] = nodes
            rows[..., n_nodes:] = nodes @ derived
    return Team(
        action_sizes=np.array(model.action_sizes),
        observation_sizes=np.array(model.observation_sizes),
        n_nodes=n_nodes,
        n_actions=n_actions,
        initial=initial,
        advance=advance,
        lost=lost,
    )


def _empty_recording(episodes: int, horizon: int, n_agents: int) -> Recording:
    rows = episodes * horizon
    return Recording(
        lengths=np.empty(episodes, dtype=np.int64),
        observations=np.empty((rows, n_agents), dtype=np.int64),
        actions=np.empty((rows, n_agents), dtype=np.int64),
        behaviour=np.empty((rows, n_agents)),
        rewards=np.empty(rows),
        last_seen=np.empty((episodes, n_agents), dtype=np.int64),
        terminated=np.zeros(episodes, dtype=np.bool_),
    )


def _packed(record: Recording, horizon: int) -> EpisodeBatch:
    """Close the gaps between the chunks of a recording, in place."""
    offsets = np.append(0, np.cumsum(record.lengths))
    tables = (record.observations, record.actions, record.behaviour, record.rewards)
    for chunk in _chunks(record.lengths.size):
        here, there = chunk.start * horizon, slice(offsets[chunk.start], offsets[chunk.stop])
        for table in tables:
            table[there] = table[here : here + there.stop - there.start]
    steps = offsets[-1]
    return EpisodeBatch(
        offsets=offsets,
        observations=record.observations[:steps],
        actions=record.actions[:steps],
        rewards=record.rewards[:steps],
        behaviour=record.behaviour[:steps],
        final_observations=record.last_seen,
        terminated=record.terminated,
    )


@njit(cache=True, inline="always")
def _choose(row, n_nodes, n_actions, available, uniform):  # type: ignore[no-untyped-def]
    """Draw one of the available actions by a filter row; return it with its probability, (2.46)."""
    total = np.float64(row[n_nodes + n_actions + 1])
    exploring = row[n_nodes + n_actions] / total
    chosen, probability, passed = 0, 0.0, 0.0
    for a in range(available):
        p = (1.0 - exploring) * row[n_nodes + a] / total + exploring / available
        if p > 0.0:
            chosen, probability = a, min(p, 1.0)
            passed += p
            if uniform < passed:
                break
    return chosen, probability


@njit(cache=True, inline="always")
def _filter(row, ahead, moves, lost, mass):  # type: ignore[no-untyped-def]
    """Overwrite a filter row by the one after an action and an observation; `mass` is its total."""
    ahead[:] = 0.0
    for i in range(moves.shape[0]):
        weight = row[i]
        for j in range(ahead.size):
            ahead[j] += weight * moves[i, j]
    if ahead[mass] > 0.0:
        scale = np.float32(1.0) / ahead[mass]
        for j in range(ahead.size):
            row[j] = ahead[j] * scale
    else:
        row[:] = lost


@njit(cache=True, inline="always")
def split_joint(joint, sizes, parts):  # type: ignore[no-untyped-def]
    """Decode a joint index, the first agent most significant."""
    for n in range(sizes.size - 1, -1, -1):
        parts[n] = joint % sizes[n]
        joint //= sizes[n]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _rollout(sampler, team, record, first, last, horizon, rng):  # type: ignore[no-untyped-def]
    n_agents, width = team.lost.shape
    mass = team.n_nodes + team.n_actions + 1
    row = np.empty((n_agents, width), dtype=np.float32)
    ahead = np.empty(width, dtype=np.float32)
    seen = np.empty(n_agents, dtype=np.int64)
    step = first * horizon
    for k in range(first, last):
        begin = step
        state = sampler.start.outcome[draw(sampler.start, 0, rng.random())]
        for n in range(n_agents):
            seen[n] = state if sampler.informative_start else team.observation_sizes[n]
            row[n] = team.initial[n, seen[n]]
        for t in range(horizon):
            joint = 0
            for n in range(n_agents):
                record.observations[step, n] = seen[n]
                available = team.action_sizes[n]
                a, p = _choose(row[n], team.n_nodes, team.n_actions, available, rng.random())
                record.actions[step, n], record.behaviour[step, n] = a, p
                joint = joint * available + a
            move = draw(sampler.transition, joint * sampler.n_states + state, rng.random())
            state = sampler.transition.outcome[move]
            sight = sampler.observation.outcome[
                draw(sampler.observation, joint * sampler.n_states + state, rng.random())
            ]
            record.rewards[step] = sampler.reward[move, sight % sampler.reward.shape[1]]
            split_joint(sight, team.observation_sizes, seen)
            step += 1
            if sampler.terminal[state]:
                record.terminated[k] = True
                break
            if t + 1 < horizon:
                for n in range(n_agents):
                    moves = team.advance[n, record.actions[step - 1, n], seen[n]]
                    _filter(row[n], ahead, moves, team.lost[n], mass)
        record.last_seen[k] = seen
        record.lengths[k] = step - begin
