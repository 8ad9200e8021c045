"""Node paths drawn from their posterior, and weighted counts of what they visited."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Counts, Messages
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray


def sample_paths(
    episodes: EpisodeBatch,
    agent: int,
    controller: Controller,
    messages: Messages,
    last: IntArray,
    rng: np.random.Generator,
) -> IntArray:
    """Draw each episode's nodes z_{0:t} given a_{0:t} and o_{1:t}; (5.5), (6.6).

    Args:
        episodes: K episodes.
        agent: whose nodes.
        controller: of that agent, under-normalised or not.
        messages: its forward messages.
        last: (K,) row of the last step t of each path; one before the episode's first row, or a
            step that the controller cannot have taken: no path.
        rng: source of the draws.

    Returns:
        (S,) nodes; -1 where there is none.
    """
    nodes: IntArray = _sample_paths(
        episodes.offsets,
        episodes.observations[:, agent],
        episodes.actions[:, agent],
        controller.successor,
        messages.alpha,
        last,
        rng.random(episodes.n_steps),
    )
    return nodes


def path_counts(
    episodes: EpisodeBatch, agent: int, controller: Controller, nodes: IntArray, weights: FloatArray
) -> Counts:
    """Count the visits of node paths (S,), each with its weight (S,).

    A move counts with the weight of the step that it leads to. The controller gives the sizes.
    """
    counts = Counts(*(np.zeros_like(table) for table in vars(controller).values()))
    seen, done = episodes.observations[:, agent], episodes.actions[:, agent]
    held = nodes >= 0
    begins = np.zeros(episodes.n_steps, dtype=np.bool_)
    begins[episodes.offsets[:-1]] = True
    first, later = held & begins, np.flatnonzero(held & ~begins)
    np.add.at(counts.initial, (seen[first], nodes[first]), weights[first])
    np.add.at(counts.action, (nodes[held], done[held]), weights[held])
    before = later - 1
    move = (done[before], seen[later], nodes[before], nodes[later])
    np.add.at(counts.successor, move, weights[later])
    return counts


def reward_steps(
    episodes: EpisodeBatch, shares: FloatArray, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Draw each episode's step t in proportion to nu_t.

    Returns:
        (K,) rows of the steps, one before the first row where an episode has no reward; and (S,)
        the sum of the episode's shares, at each of its steps.
    """
    first, lengths = episodes.offsets[:-1], episodes.lengths
    total = np.add.reduceat(shares, first)
    ahead = np.cumsum(shares)
    before = ahead[first] - shares[first]
    wanted = before + rng.random(total.size) * total
    last = np.minimum(np.searchsorted(ahead, wanted, side="right"), first + lengths - 1)
    return np.where(total > 0.0, last, first - 1), np.repeat(total, lengths)


@njit(cache=True)
def _sample_paths(offsets, observations, actions, successor, alpha, last, uniform):  # type: ignore[no-untyped-def]
    n_nodes = alpha.shape[1]
    nodes = np.full(observations.size, -1, dtype=np.int64)
    weight = np.empty(n_nodes)
    for k in range(offsets.size - 1):
        for t in range(last[k], offsets[k] - 1, -1):
            total = 0.0
            for i in range(n_nodes):
                weight[i] = alpha[t, i]
                if t < last[k]:
                    weight[i] *= successor[actions[t], observations[t + 1], i, nodes[t + 1]]
                total += weight[i]
            if total <= 0.0:
                break
            passed = uniform[t] * total
            for i in range(n_nodes):
                if weight[i] > 0.0:
                    nodes[t] = i
                    passed -= weight[i]
                    if passed < 0.0:
                        break
    return nodes
