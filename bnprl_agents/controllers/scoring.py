"""Compiled scoring: the returns of controllers on a tabular model, a few draws a step.

Here nodes are sampled instead of filtered. The law of states, actions and observations is that of
`rollout`, but a step costs O(1) whatever the number of nodes, and no probability is recorded: for
evaluation and for search, not for learning.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import csr_array

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.rollout import check_fit, check_size, in_chunks, split_joint
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import AliasTable, alias_table, draw


class NodeSampler(NamedTuple):
    """Alias tables of N agents' controllers, each kind in one table.

    Attributes:
        action_sizes: (N,) actions of each agent.
        observation_sizes: (N,) observations of each agent, the null observation not counted.
        controller_sizes: (N, 2) observations (all values) and nodes of each controller.
        initial, action, successor: the rows of all agents.
        first: (N, 3) where each agent's rows begin in the three tables.
    """

    action_sizes: IntArray
    observation_sizes: IntArray
    controller_sizes: IntArray
    initial: AliasTable
    action: AliasTable
    successor: AliasTable
    first: IntArray


class Scores(NamedTuple):
    """What K episodes earned.

    Attributes:
        returns: (K,) discounted returns.
        lengths: (K,) steps.
        rewards: (K,) sums of rewards, not discounted.
    """

    returns: FloatArray
    lengths: IntArray
    rewards: FloatArray


def simulated_returns(
    model: TabularModel,
    controllers: Controller | Sequence[Controller],
    *,
    episodes: int,
    horizon: int,
    discount: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, IntArray]:
    """Discounted returns (K,) and lengths (K,) of episodes; see `simulated_scores`."""
    found = simulated_scores(
        model, controllers, episodes=episodes, horizon=horizon, discount=discount, rng=rng
    )
    return found.returns, found.lengths


def simulated_scores(
    model: TabularModel,
    controllers: Controller | Sequence[Controller],
    *,
    episodes: int,
    horizon: int,
    discount: float,
    rng: np.random.Generator,
) -> Scores:
    """Simulate episodes under the controllers and sum what they earn.

    Args:
        model: what is simulated.
        controllers: one for each agent, rows summing to 1; a single one is a team of one.
        episodes: K, at least 1.
        horizon: largest number of steps of an episode, at least 1.
        discount: factor in (0, 1].
        rng: source of every draw; it is advanced.

    Raises:
        ValueError: the controllers do not fit the model, or a number is out of range.
    """
    team = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    check_fit(model, team)
    check_size(episodes, horizon)
    if not 0.0 < discount <= 1.0:
        raise ValueError(f"discount: {discount}, must lie in (0, 1]")
    nodes = _node_sampler(model, team)
    parts = in_chunks(
        lambda chunk, stream: _score(model.sampler, nodes, len(chunk), horizon, discount, stream),
        episodes,
        rng,
    )
    return Scores(*map(np.concatenate, zip(*parts, strict=True)))


def _node_sampler(model: TabularModel, team: Sequence[Controller]) -> NodeSampler:
    rows = [
        [table.reshape(-1, table.shape[-1]) for table in (c.initial, c.action, c.successor)]
        for c in team
    ]
    counts = np.array([[len(table) for table in each] for each in rows])
    initial, action, successor = (_joined([each[kind] for each in rows]) for kind in range(3))
    return NodeSampler(
        action_sizes=np.array(model.action_sizes),
        observation_sizes=np.array(model.observation_sizes),
        controller_sizes=np.array([[c.n_observations, c.n_nodes] for c in team]),
        initial=initial,
        action=action,
        successor=successor,
        first=np.cumsum(counts, axis=0) - counts,
    )


def _joined(tables: Sequence[FloatArray]) -> AliasTable:
    """One alias table over the rows of several tables, whatever their widths."""
    sparse = [csr_array(table) for table in tables]
    starts = np.cumsum([0] + [rows.nnz for rows in sparse])
    data = np.concatenate([rows.data for rows in sparse])
    indices = np.concatenate([rows.indices for rows in sparse])
    pointers = [rows.indptr[:-1] + start for rows, start in zip(sparse, starts, strict=False)]
    indptr = np.concatenate([*pointers, starts[-1:]])
    width = max(rows.shape[1] for rows in sparse)
    return alias_table(csr_array((data, indices, indptr), shape=(indptr.size - 1, width)))


@njit(cache=True, nogil=True)
def _score(sampler, nodes, episodes, horizon, discount, rng):  # type: ignore[no-untyped-def]
    n_agents = nodes.action_sizes.size
    returns, rewards = np.zeros(episodes), np.zeros(episodes)
    lengths = np.empty(episodes, dtype=np.int64)
    node = np.empty(n_agents, dtype=np.int64)
    action, seen = np.empty_like(node), np.empty_like(node)
    for k in range(episodes):
        state = sampler.start.outcome[draw(sampler.start, 0, rng.random())]
        for n in range(n_agents):
            seen[n] = state if sampler.informative_start else nodes.observation_sizes[n]
            row = nodes.first[n, 0] + seen[n]
            node[n] = nodes.initial.outcome[draw(nodes.initial, row, rng.random())]
        factor = 1.0
        for t in range(horizon):
            joint = 0
            for n in range(n_agents):
                row = nodes.first[n, 1] + node[n]
                action[n] = nodes.action.outcome[draw(nodes.action, row, rng.random())]
                joint = joint * nodes.action_sizes[n] + action[n]
            move = draw(sampler.transition, joint * sampler.n_states + state, rng.random())
            state = sampler.transition.outcome[move]
            sight = sampler.observation.outcome[
                draw(sampler.observation, joint * sampler.n_states + state, rng.random())
            ]
            reward = sampler.reward[move, sight % sampler.reward.shape[1]]
            returns[k] += factor * reward
            rewards[k] += reward
            factor *= discount
            lengths[k] = t + 1
            if sampler.terminal[state]:
                break
            split_joint(sight, nodes.observation_sizes, seen)
            for n in range(n_agents):
                n_seen, n_nodes = nodes.controller_sizes[n]
                row = nodes.first[n, 2] + (action[n] * n_seen + seen[n]) * n_nodes + node[n]
                node[n] = nodes.successor.outcome[draw(nodes.successor, row, rng.random())]
    return returns, lengths, rewards
