"""What the compiled simulators share: bookkeeping, and random numbers that are functions."""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.search.simulator import UInt64Array, effective_horizon
from bnprl_agents.search.tables import DecisionTables

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""What SplitMix64 adds to its state for each number (Steele, Lea and Flood 2014)."""
UNIT = 2.0**-32
"""Turns half of a hashed number into one in [0, 1)."""


class Record(NamedTuple):
    """What a simulation writes down beside the returns.

    Attributes:
        visits: (M, Z + 1, O) discounted lookups of successors; empty: not counted.
        explorer: the agent that explores, -1 for none.
        exploration: probability with which it acts uniformly at random.
        followed: (Z, A, O + 2) its node, its action, and what followed: an observation, `OVER`,
            or `CUT`.
        earned: (Z, A) sum of rewards after its action.
    """

    visits: FloatArray
    explorer: int
    exploration: float
    followed: IntArray
    earned: FloatArray


class CompiledSimulator(abc.ABC):
    """A `TeamSimulator` whose episodes are one compiled loop.

    The random numbers of a seed's episode are a function of the seed and the time, whatever the
    team does, so that candidates that decide alike see the same world.

    Args:
        action_sizes: actions of each agent.
        observation_sizes: values of each agent's observation space.
        discount: factor in (0, 1].
        max_episode_steps: of an episode, at least 1.
    """

    def __init__(
        self,
        action_sizes: tuple[int, ...],
        observation_sizes: tuple[int, ...],
        *,
        discount: float,
        max_episode_steps: int,
    ) -> None:
        self.action_sizes = action_sizes
        self.observation_sizes = observation_sizes
        self.discount = discount
        self.horizon = effective_horizon(discount, max_episode_steps)
        self.copies = 1
        self.episodes = 0
        self.steps = 0

    def returns(self, teams: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Discounted return (B, E) of every candidate's episode of every seed."""
        return self._counted(teams, seeds, _record())

    def visits(self, team: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Mean discounted number of times (M, Z + 1, O) that a node's successor was looked up."""
        record = _record()._replace(visits=np.zeros(team.successor.shape[1:]))
        self._counted(team, seeds, record)
        return record.visits / len(seeds)

    def experience(
        self, team: DecisionTables, agent: int, exploration: float, seeds: UInt64Array
    ) -> tuple[IntArray, FloatArray]:
        """Explore as one agent; see `TeamSimulator.experience`."""
        shape = (team.start, self.action_sizes[agent], team.successor.shape[3] + 2)
        record = _record()._replace(
            explorer=agent,
            exploration=exploration,
            followed=np.zeros(shape, dtype=np.int64),
            earned=np.zeros(shape[:2]),
        )
        self._counted(team, seeds, record)
        return record.followed, record.earned

    def _counted(self, teams: DecisionTables, seeds: UInt64Array, record: Record) -> FloatArray:
        returns = np.zeros((len(teams.action), len(seeds)))
        self.steps += self._simulate(teams, seeds, returns, record)
        self.episodes += returns.size
        return returns

    @abc.abstractmethod
    def _simulate(
        self, teams: DecisionTables, seeds: UInt64Array, returns: FloatArray, record: Record
    ) -> int:
        """Fill `returns` (B, E) and the record.

        Returns:
            The steps taken.
        """


def _record() -> Record:
    return Record(
        np.zeros((0, 0, 0)), -1, 0.0, np.zeros((0, 0, 0), dtype=np.int64), np.zeros((0, 0))
    )


@njit(cache=True, inline="always")
def hashed(x):  # type: ignore[no-untyped-def]
    """The output function of SplitMix64: 64 random bits from a 64-bit state."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(cache=True, inline="always")
def explored(x, exploration, chosen, n_actions):  # type: ignore[no-untyped-def]
    """The action itself, or with some probability a uniformly random one."""
    bits = hashed(~x)
    if (bits >> np.uint64(32)) * UNIT < exploration:
        return int((bits & np.uint64(0xFFFFFFFF)) * UNIT * n_actions)
    return chosen
