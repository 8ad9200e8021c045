"""What random teams meet, before the search begins."""

from __future__ import annotations

import numpy as np

from bnprl_agents.episodes import BoolArray, IntArray
from bnprl_agents.search.simulator import TeamSimulator
from bnprl_agents.search.tables import DecisionTables

LOOKS = 256
"""Random teams, of one episode each."""


def observations_met(
    simulator: TeamSimulator,
    roles: IntArray,
    action_sizes: IntArray,
    n_observations: int,
    n_nodes: int,
    rng: np.random.Generator,
) -> BoolArray:
    """Which observations (M, O) the roles of random teams meet after their first action.

    Args:
        simulator: of the environment.
        roles: (N,) role of each agent.
        action_sizes: (M,) actions of each role.
        n_observations: O.
        n_nodes: Z of the random teams.
        rng: source of the teams and of the episodes' seeds.
    """
    n_roles = len(action_sizes)
    met = np.zeros((n_roles, n_observations), dtype=np.bool_)
    for _ in range(LOOKS):
        action = rng.integers(action_sizes[:, None], size=(1, n_roles, n_nodes))
        successor = rng.integers(n_nodes, size=(1, n_roles, n_nodes + 1, n_observations))
        team = DecisionTables(roles, action.astype(np.int32), successor.astype(np.int32))
        seed = rng.integers(2**64, size=1, dtype=np.uint64)
        met |= simulator.visits(team, seed)[:, :-1].any(axis=1)
    return met
