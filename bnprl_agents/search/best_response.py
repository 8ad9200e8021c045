"""Best responses of one agent after the other, from episodes in which it explores."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.search.simulator import CUT, OVER, TeamSimulator, UInt64Array
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
        followed, earned = simulator.experience(team, agent, EXPLORATION, own)
        response = best_response(team, agent, followed, earned, discount, simulator.horizon)
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
    followed: IntArray,
    earned: FloatArray,
    discount: float,
    horizon: int,
) -> DecisionTables:
    """The team with an agent's actions replaced by its best ones, its nodes taken as states.

    Value iteration on Q(z, a) = r(z, a) + discount sum_o p(o | z, a) max_b Q(z'(z, o), b), where r
    and p are estimated by `estimates`: the best response within the memory, if that is Markov.

    Args:
        team: one candidate.
        agent: who responds.
        followed: (Z, A, O + 2) what followed an action in a node; see `TeamSimulator.experience`.
        earned: (Z, A) sum of the rewards of an action in a node.
        discount: factor in (0, 1].
        horizon: sweeps.
    """
    role = team.roles[agent]
    trusted = followed.sum(axis=2) >= TRUSTED
    decided = trusted.any(axis=1)
    reward, chance = estimates(followed, earned)
    quality = values_of_actions(
        chance, reward, trusted, team.successor[0, role, :-1], discount, horizon
    )
    action = team.action.copy()
    action[0, role, decided] = quality[decided].argmax(axis=1)
    return DecisionTables(team.roles, action, team.successor)


def estimates(followed: IntArray, earned: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean reward r(z, a), (Z, A), and chance p(o | z, a) of each observation, (Z, A, O).

    The reward is a mean over all actions, the chance one over those that the horizon did not cut,
    for the horizon tells nothing of what the action leads to, and the sweeps count it already.
    Chances sum to less than 1 where episodes end, and to 0 in a node that is met at the horizon's
    last step alone: there the reward is all that the action can bring.
    """
    seen, known = followed[..., :OVER], followed[..., :CUT].sum(axis=2)
    reward = earned / np.maximum(followed.sum(axis=2), 1)
    return reward, seen / np.maximum(known, 1)[..., None]


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
