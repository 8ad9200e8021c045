"""The best teams found so far, best first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.policy_files import Arrays
from bnprl_agents.search.tables import DecisionTables


class Leaderboard(NamedTuple):
    """Teams by decreasing value.

    Attributes:
        values: (B,) judged values.
        labels: (B,) what the owner wants to know of a team.
        teams: its B candidates.
    """

    values: FloatArray
    labels: IntArray
    teams: DecisionTables

    @classmethod
    def empty(cls, roles: IntArray, n_nodes: int, n_observations: int) -> Leaderboard:
        """A board without teams."""
        n_roles = int(roles.max()) + 1
        return cls(
            np.zeros(0),
            np.zeros(0, dtype=np.int64),
            DecisionTables(
                roles,
                np.zeros((0, n_roles, n_nodes), dtype=np.int32),
                np.zeros((0, n_roles, n_nodes + 1, n_observations), dtype=np.int32),
            ),
        )

    def added(self, team: DecisionTables, value: float, label: int, size: int) -> Leaderboard:
        """The board of the best `size` teams with one more; one of a known value is left out."""
        if np.isclose(self.values, value, rtol=1e-9, atol=0.0).any():
            return self
        values = np.append(self.values, value)
        kept = np.argsort(-values, kind="stable")[:size]
        action = np.concatenate([self.teams.action, team.action])
        successor = np.concatenate([self.teams.successor, team.successor])
        return Leaderboard(
            values[kept],
            np.append(self.labels, label)[kept],
            DecisionTables(team.roles, action[kept], successor[kept]),
        )

    def moved(self, team: DecisionTables, value: float, label: int) -> Leaderboard:
        """The board with this team in the place of any other of its label."""
        others = self.labels != label
        values = np.append(self.values[others], value)
        order = np.argsort(-values, kind="stable")
        action = np.concatenate([self.teams.action[others], team.action])
        successor = np.concatenate([self.teams.successor[others], team.successor])
        return Leaderboard(
            values[order],
            np.append(self.labels[others], label)[order],
            DecisionTables(team.roles, action[order], successor[order]),
        )

    def without(self, b: int) -> Leaderboard:
        """The board without one team."""
        kept = np.flatnonzero(np.arange(self.values.size) != b)
        return Leaderboard(self.values[kept], self.labels[kept], self.teams.candidates(kept))

    def state_arrays(self, name: str) -> Arrays:
        """Everything but the roles, for saving."""
        return {
            f"{name}_values": self.values,
            f"{name}_labels": self.labels,
            f"{name}_action": self.teams.action,
            f"{name}_successor": self.teams.successor,
        }

    def restored(self, name: str, arrays: Arrays, action_sizes: IntArray) -> Leaderboard:
        """The board that `state_arrays` gave, for the same roles, actions (M,) and sizes.

        Raises:
            ValueError: an array does not fit.
        """
        values, labels, action, successor = (
            arrays[f"{name}_{part}"] for part in ("values", "labels", "action", "successor")
        )
        size = len(values)
        for part, array, wanted in (
            ("labels", labels, (size,)),
            ("action", action, (size, *self.teams.action.shape[1:])),
            ("successor", successor, (size, *self.teams.successor.shape[1:])),
        ):
            if array.shape != wanted:
                raise ValueError(f"{name}_{part}: shape {array.shape}, must be {wanted}")
        if successor.size and not 0 <= successor.min() <= successor.max() < action.shape[2]:
            raise ValueError(f"{name}_successor: holds a node that does not exist")
        if not ((action >= 0) & (action < action_sizes[:, None])).all():
            raise ValueError(f"{name}_action: holds an action that does not exist")
        return Leaderboard(values, labels, DecisionTables(self.teams.roles, action, successor))
