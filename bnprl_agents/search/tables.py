"""Deterministic controllers of a team as integer tables.

Glossary: B candidates, N agents, M roles (agents of one role share their tables), Z nodes,
O observations of one agent, A actions of one agent, E seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import BoolArray, IntArray

Int32Array = npt.NDArray[np.int32]


class DecisionTables(NamedTuple):
    """B candidate teams of deterministic finite-state controllers, padded to common sizes.

    Attributes:
        roles: (N,) which tables each agent uses.
        action: (B, M, Z) action of each node.
        successor: (B, M, Z + 1, O) node after an observation; the last row, `start`, tells the
            first node by the first observation.
    """

    roles: IntArray
    action: Int32Array
    successor: Int32Array

    @property
    def start(self) -> int:
        """The row of `successor` that stands before the first observation, Z."""
        return int(self.action.shape[2])

    def candidate(self, b: int) -> DecisionTables:
        """One candidate, as a copy with B = 1."""
        return self.candidates([b])

    def candidates(self, chosen: Sequence[int] | IntArray) -> DecisionTables:
        """Some candidates, as copies."""
        return DecisionTables(self.roles, self.action[chosen], self.successor[chosen])

    def reachable(self) -> BoolArray:
        """Nodes (M, Z) of the first candidate that some sequence of observations leads to."""
        reached = np.zeros(self.action.shape[1:], dtype=np.bool_)
        for role, successor in enumerate(self.successor[0]):
            reached[role, reachable(successor)] = True
        return reached

    def controllers(
        self, action_sizes: Sequence[int], observation_sizes: Sequence[int]
    ) -> tuple[Controller, ...]:
        """The first candidate as one `Controller` an agent, with as few nodes as can be."""
        made: dict[int, Controller] = {}
        for role, n_actions, n_observations in zip(
            self.roles.tolist(), action_sizes, observation_sizes, strict=True
        ):
            if role not in made:
                made[role] = _controller(
                    self.action[0, role],
                    self.successor[0, role, :, :n_observations],
                    n_actions,
                )
        return tuple(made[role] for role in self.roles.tolist())


def _controller(action: Int32Array, successor: Int32Array, n_actions: int) -> Controller:
    """The smallest controller that decides as some tables (Z,), (Z + 1, O) do."""
    kept = reachable(successor)
    block = equivalent(action, successor, kept)
    _, example = np.unique(block[kept], return_index=True)
    nodes, seen = np.arange(example.size), np.arange(successor.shape[1])
    initial = np.zeros((seen.size, nodes.size))
    initial[seen, block[successor[-1]]] = 1.0
    chosen = np.zeros((nodes.size, n_actions))
    chosen[nodes, action[kept[example]]] = 1.0
    moves = np.zeros((seen.size, nodes.size, nodes.size))
    moves[seen[:, None], nodes, block[successor[kept[example]].T]] = 1.0
    return Controller(initial, chosen, np.repeat(moves[None], n_actions, axis=0))


def reachable(successor: Int32Array) -> IntArray:
    """Nodes, ascending, to which some sequence of observations leads; `successor` is (Z + 1, O)."""
    reached = np.zeros(len(successor) - 1, dtype=np.bool_)
    fringe = np.unique(successor[-1])
    while fringe.size:
        reached[fringe] = True
        ahead = np.unique(successor[fringe])
        fringe = ahead[~reached[ahead]]
    return np.flatnonzero(reached)


def equivalent(action: Int32Array, successor: Int32Array, kept: IntArray) -> IntArray:
    """Number (Z,) of each kept node's class: nodes of one act alike for ever (Moore 1956)."""
    block = np.zeros(action.size, dtype=np.int64)
    block[kept] = np.unique(action[kept], return_inverse=True)[1]
    while True:
        future = np.concatenate([block[kept, None], block[successor[kept]]], axis=1)
        _, finer = np.unique(future, axis=0, return_inverse=True)
        if finer.max() == block[kept].max():
            return block
        block[kept] = finer.ravel()
