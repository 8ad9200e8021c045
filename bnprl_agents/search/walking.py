"""How a team is disturbed, and walks: after a disturbance all agents respond again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.episodes import IntArray
from bnprl_agents.search.best_response import respond_in_turn
from bnprl_agents.search.moves import ACT, BRANCH, REDIRECT, apply_moves, list_moves
from bnprl_agents.search.simulator import TeamSimulator, UInt64Array
from bnprl_agents.search.tables import DecisionTables

ROUNDS = 8
"""Disturbances of one walk."""
CHANGES = 6
"""Most actions that a disturbance changes."""


class Found(NamedTuple):
    """A team and its mean return on the seeds of a walk."""

    team: DecisionTables
    value: float


def walk(
    simulator: TeamSimulator,
    team: DecisionTables,
    seeds: UInt64Array,
    discount: float,
    rng: np.random.Generator,
) -> tuple[Found, Found]:
    """Disturb and respond, and go on from what is not clearly worse.

    Responses stop where no agent gains alone. To leave such a place one agent changes some
    actions, the others respond to that first, and it responds to them: plans change together. A
    loss of an exponentially distributed number of standard errors, one on average, is accepted.

    Returns:
        Where the walk ended, and the best team on its way.
    """
    n_agents = team.roles.size

    def responded(begun: DecisionTables, first: int) -> tuple[Found, float]:
        after = respond_in_turn(simulator, begun, seeds, discount, rng, first)
        returns = simulator.returns(after, seeds)[0]
        return Found(after, float(returns.mean())), float(returns.std() / np.sqrt(seeds.size))

    here, error = responded(team, 0)
    best = here
    for _ in range(ROUNDS):
        agent = int(rng.integers(n_agents))
        changed = disturbed(simulator, here.team, agent, seeds[:32], rng)
        found, new_error = responded(changed, (agent + 1) % n_agents)
        if found.value >= here.value - rng.exponential(error):
            here, error = found, new_error
        if here.value > best.value:
            best = here
    return here, best


def disturbed(
    simulator: TeamSimulator,
    team: DecisionTables,
    agent: int,
    seeds: UInt64Array,
    rng: np.random.Generator,
) -> DecisionTables:
    """The team with some actions of an agent drawn anew, most often in nodes that it visits."""
    role = team.roles[agent]
    arrivals = np.zeros(team.action.shape[2])
    np.add.at(arrivals, team.successor[0, role], simulator.visits(team, seeds)[role])
    share = np.sqrt(arrivals) / np.sqrt(arrivals).sum()
    size = min(int(rng.integers(1, CHANGES, endpoint=True)), int(np.count_nonzero(share)))
    nodes = rng.choice(share.size, size=size, replace=False, p=share)
    action = team.action.copy()
    action[0, role, nodes] = rng.integers(simulator.action_sizes[agent], size=size)
    return DecisionTables(team.roles, action, team.successor)


def kicked(
    simulator: TeamSimulator,
    team: DecisionTables,
    action_sizes: IntArray,
    most: int,
    rng: np.random.Generator,
) -> DecisionTables:
    """The team after up to `most` random moves, most often at entries that it visits.

    Args:
        simulator: tells what the team visits.
        team: one candidate.
        action_sizes: (M,) actions of each role.
        most: moves, at least 1.
        rng: source of the moves and of the episodes' seeds.
    """
    for _ in range(int(rng.integers(1, most, endpoint=True))):
        visits = simulator.visits(team, rng.integers(2**64, size=64, dtype=np.uint64))
        moves, weight = list_moves(team, visits, action_sizes, (ACT, REDIRECT, BRANCH))
        share = np.sqrt(weight) / np.sqrt(weight).sum()
        team = apply_moves(team, moves[[rng.choice(len(moves), p=share)]])
    return team
