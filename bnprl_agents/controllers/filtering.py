"""What node each agent is in before it acts, along recorded episodes."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import EpisodeBatch, FloatArray


def node_beliefs(episodes: EpisodeBatch, agent: int, controller: Controller) -> FloatArray:
    """p(z_t | h_t) before the action at t, (S, Z), filtered as in acting; (2.43), (2.44).

    As with `Controller.advance`, it is uniform after a history that the controller cannot produce.

    Args:
        episodes: K episodes whose actions and observations the controller has.
        agent: whose.
        controller: its rows sum to 1.
    """
    nodes: FloatArray = _filter(
        episodes.offsets,
        episodes.observations[:, agent],
        episodes.actions[:, agent],
        controller.initial,
        np.ascontiguousarray(controller.action.T),
        controller.successor,
    )
    return nodes


@njit(cache=True)
def _filter(offsets, observations, actions, initial, action, successor):  # type: ignore[no-untyped-def]
    n_nodes = action.shape[1]
    nodes = np.zeros((observations.size, n_nodes))
    for k in range(offsets.size - 1):
        begin = offsets[k]
        nodes[begin] = initial[observations[begin]]
        for t in range(begin + 1, offsets[k + 1]):
            move, chance = successor[actions[t - 1], observations[t]], action[actions[t - 1]]
            for i in range(n_nodes):
                weight = nodes[t - 1, i] * chance[i]
                if weight > 0.0:
                    for j in range(n_nodes):
                        nodes[t, j] += weight * move[i, j]
            total = 0.0
            for j in range(n_nodes):
                total += nodes[t, j]
            if total > 0.0:
                nodes[t] /= total
            else:
                nodes[t] = 1.0 / n_nodes
    return nodes
