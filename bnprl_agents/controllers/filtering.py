"""What nodes each agent is in before it acts, along recorded episodes."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Messages
from bnprl_agents.episodes import EpisodeBatch, FloatArray


def mean_before_acting(
    episodes: EpisodeBatch,
    agent: int,
    controller: Controller,
    messages: Messages,
    quantity: FloatArray,
) -> FloatArray:
    """sum_z p(z_t | h_t) quantity[z] before the action at t, (S,), filtered as in acting; (2.43).

    By the messages that is sum_i alpha_{t-1}(i) sum_j W[a_{t-1}, o_t, i, j] quantity[j], in time
    O(S Z). As with `Controller.advance`, the distribution is uniform after a history that the
    controller cannot produce, and goes on from there.

    Args:
        episodes: K episodes.
        agent: whose.
        controller: its rows sum to 1.
        messages: its forward messages.
        quantity: (Z,).
    """
    found: FloatArray = _mean_before_acting(
        episodes.offsets,
        episodes.observations[:, agent],
        episodes.actions[:, agent],
        controller.action,
        controller.successor,
        messages.alpha,
        messages.likelihood,
        quantity,
        controller.initial @ quantity,
        controller.successor @ quantity,
    )
    return found


@njit(cache=True)
def _mean_before_acting(  # type: ignore[no-untyped-def]
    offsets, observations, actions, action, successor, alpha, likelihood, quantity, first, ahead
):
    n_nodes = action.shape[0]
    found = np.empty(observations.size)
    node, work = np.empty(n_nodes), np.empty(n_nodes)
    for k in range(offsets.size - 1):
        begin, lost = offsets[k], False
        found[begin] = first[observations[begin]]
        for t in range(begin + 1, offsets[k + 1]):
            a, o = actions[t - 1], observations[t]
            if likelihood[t - 1] > 0.0:
                found[t] = (alpha[t - 1] * ahead[a, o]).sum()
                continue
            if lost:
                filter_node(node, action[:, a], successor[a, o], work)
            else:
                node[:], lost = 1.0 / n_nodes, True
            found[t] = (node * quantity).sum()
    return found


@njit(cache=True)
def filter_node(node, chance, move, work):  # type: ignore[no-untyped-def]
    """Filter one node distribution (Z,) in place; see `Controller.advance`.

    Args:
        node: the distribution.
        chance: (Z,) probability of the action.
        move: (Z, Z) of the action and the observation after it.
        work: (Z,) scratch.
    """
    work[:] = 0.0
    for i in range(node.size):
        work += node[i] * chance[i] * move[i]
    total = work.sum()
    if total > 0.0:
        node[:] = work / total
    else:
        node[:] = 1.0 / node.size
