"""Best responses of one agent after the other, from episodes in which it explores."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.search.simulator import TeamSimulator, UInt64Array
from bnprl_agents.search.tables import DecisionTables

EXPLORATION = 0.2
"""Probability with which the responding agent acts uniformly at random."""
TRUSTED = 3
"""Times that an action must have been tried in a node before it may be chosen there."""
SEEDS = 128
"""Episodes from which a response is learned."""


def respond_in_turn(
    simulator: TeamSimulator,
    team: DecisionTables,
    seeds: UInt64Array,
    discount: float,
    rng: np.random.Generator,
    first: int = 0,
) -> DecisionTables:
    """Let the agents respond to each other, from the first one on, until no response is better.

    A response is kept if it is better on the seeds, so that the value never falls. In a team whose
    agents share tables nobody can respond alone, and it comes back as it is.
    """
    n_agents = team.roles.size
    if team.action.shape[1] < n_agents:
        return team
    value = simulator.returns(team, seeds)[0].mean()
    agent, refused = first, 0
    while refused < n_agents:
        own = rng.integers(2**64, size=SEEDS, dtype=np.uint64)
        tried, earned = simulator.experience(team, agent, EXPLORATION, own)
        response = best_response(team, agent, tried, earned, discount, simulator.horizon)
        found = simulator.returns(response, seeds)[0].mean()
        if found > value:
            team, value, refused = response, found, 0
        else:
            refused += 1
        agent = (agent + 1) % n_agents
    return team


def best_response(
    team: DecisionTables,
    agent: int,
    tried: IntArray,
    earned: FloatArray,
    discount: float,
    horizon: int,
) -> DecisionTables:
    """The team with an agent's actions replaced by its best ones, its nodes taken as states.

    Value iteration on Q(z, a) = r(z, a) + discount sum_o p(o | z, a) max_b Q(z'(z, o), b), where r
    and p are the means of what was tried: the best response within the memory, if that is Markov.

    Args:
        team: one candidate.
        agent: who responds.
        tried: (Z, A, O) how often an observation followed an action in a node.
        earned: (Z, A) sum of the rewards of an action in a node.
        discount: factor in (0, 1].
        horizon: sweeps.
    """
    role = team.roles[agent]
    times = tried.sum(axis=2)
    trusted = times >= TRUSTED
    decided = trusted.any(axis=1)
    reward = earned / np.maximum(times, 1)
    chance = tried / np.maximum(times, 1)[..., None]
    quality = values_of_actions(
        chance, reward, trusted, team.successor[0, role, :-1], discount, horizon
    )
    action = team.action.copy()
    action[0, role, decided] = quality[decided].argmax(axis=1)
    return DecisionTables(team.roles, action, team.successor)


@njit(cache=True)
def values_of_actions(  # type: ignore[no-untyped-def]
    chance, reward, trusted, successor, discount, horizon
):
    """Sweep Q(z, a), minus infinity where an action is not trusted; see `best_response`."""
    n_nodes, n_actions, n_seen = chance.shape
    value = np.zeros(n_nodes)
    quality = np.full((n_nodes, n_actions), -np.inf)
    for _ in range(horizon):
        for z in range(n_nodes):
            for a in range(n_actions):
                if trusted[z, a]:
                    ahead = 0.0
                    for o in range(n_seen):
                        ahead += chance[z, a, o] * value[successor[z, o]]
                    quality[z, a] = reward[z, a] + discount * ahead
        for z in range(n_nodes):
            best = quality[z].max()
            value[z] = best if best > -np.inf else 0.0
    return quality
