"""Small changes of decision tables: the neighbourhood of the search.

A move is a row (kind, role, node, observation, target) of integers.
"""

from __future__ import annotations

import numpy as np

from bnprl_agents.episodes import BoolArray, FloatArray, IntArray
from bnprl_agents.search.tables import DecisionTables

ACT, REDIRECT, BRANCH = range(3)
"""ACT: the node takes the action `target`. REDIRECT: the observation leads from the node to the
node `target`. BRANCH: it leads to a new node, a copy of where it led with the action `target`:
the team decides otherwise after this memory alone, and remembers that it came here."""

RARE = 1e-4
"""Discounted visits an episode below which an entry is not worth a move."""


def list_moves(
    team: DecisionTables, visits: FloatArray, action_sizes: IntArray, kinds: tuple[int, ...]
) -> tuple[IntArray, FloatArray]:
    """Every move (L, 5) of some kinds at entries that are visited, and the entries' visits (L,).

    Args:
        team: one candidate.
        visits: (M, Z + 1, O) of it, from `TeamSimulator.visits`.
        action_sizes: (M,) actions of each role.
        kinds: of the moves.
    """
    reached = team.reachable()
    parts: list[tuple[IntArray, FloatArray]] = []
    for role, n_actions in enumerate(action_sizes.tolist()):
        action, successor = team.action[0, role], team.successor[0, role]
        node, seen = np.nonzero(visits[role] > RARE)
        weight = visits[role, node, seen]
        target = successor[node, seen]
        if ACT in kinds:
            arrivals: FloatArray = np.zeros(action.size)
            np.add.at(arrivals, target, weight)
            acting = np.flatnonzero(arrivals)
            parts.append(_others(ACT, role, acting, 0, action[acting], n_actions, arrivals[acting]))
        if REDIRECT in kinds:
            parts.append(
                _others(REDIRECT, role, node, seen, target, action.size, weight, reached[role])
            )
        if BRANCH in kinds and not reached[role].all():
            parts.append(_others(BRANCH, role, node, seen, action[target], n_actions, weight))
    return (
        np.concatenate([moves for moves, _ in parts]),
        np.concatenate([weights for _, weights in parts]),
    )


def _others(
    kind: int,
    role: int,
    node: IntArray,
    seen: IntArray | int,
    present: IntArray,
    size: int,
    weight: FloatArray,
    allowed: BoolArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """All moves of entries to another value in [0, size), allowed ones only."""
    other = np.arange(size) != present[:, None]
    if allowed is not None:
        other &= allowed
    entry, target = np.nonzero(other)
    moves = np.empty((entry.size, 5), dtype=np.int64)
    moves[:, 0], moves[:, 1], moves[:, 2] = kind, role, node[entry]
    moves[:, 3] = np.broadcast_to(seen, node.shape)[entry]
    moves[:, 4] = target
    return moves, weight[entry]


def apply_moves(team: DecisionTables, moves: IntArray) -> DecisionTables:
    """One candidate for each move (L, 5) of a team."""
    action = np.repeat(team.action, len(moves), axis=0)
    successor = np.repeat(team.successor, len(moves), axis=0)
    free = team.reachable().argmin(axis=1)
    for b, (kind, role, node, seen, target) in enumerate(moves.tolist()):
        if kind == ACT:
            action[b, role, node] = target
        elif kind == REDIRECT:
            successor[b, role, node, seen] = target
        else:
            new = free[role]
            successor[b, role, new] = successor[b, role, successor[b, role, node, seen]]
            action[b, role, new] = target
            successor[b, role, node, seen] = new
    return DecisionTables(team.roles, action, successor)
