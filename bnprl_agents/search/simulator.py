"""What the search asks of a simulator, and how an environment becomes one."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.search.tables import DecisionTables
from bnprl_envs.grid_traffic_batch import GridTrafficBatch
from bnprl_envs.horizon import horizon_of
from bnprl_envs.model import TabularModel

UInt64Array = npt.NDArray[np.uint64]

TAIL = 2e-3
"""Share of the discounted weight that may lie beyond the steps that are simulated."""
OVER, CUT = -2, -1
"""What may follow an action instead of an observation: the end of the episode, or the horizon,
behind which nobody looks."""


class TeamSimulator(Protocol):
    """All that the search knows of a problem: sizes, and what candidates earn.

    Attributes:
        action_sizes: actions of each agent.
        observation_sizes: values of each agent's observation space.
        horizon: most steps of an episode.
        copies: episodes that a seed begins.
    """

    action_sizes: tuple[int, ...]
    observation_sizes: tuple[int, ...]
    horizon: int
    copies: int

    @property
    def episodes(self) -> int:
        """Simulated so far."""

    @property
    def steps(self) -> int:
        """Simulated so far."""

    def returns(self, teams: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Discounted return (B, E) of each candidate; a seed fixes all that chance decides."""

    def visits(self, team: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Mean discounted number of times (M, Z + 1, O) that a node's successor was looked up."""

    def experience(
        self, team: DecisionTables, agent: int, exploration: float, seeds: UInt64Array
    ) -> tuple[IntArray, FloatArray]:
        """What happens to an agent that acts uniformly at random with some probability.

        Returns:
            (Z, A, O + 2) how often an observation followed an action in a node, or its episode was
            `OVER`, or `CUT` by the horizon; and (Z, A) the sum of the rewards that followed.
        """


class BudgetSpentError(Exception):
    """A simulation would take more steps than are left."""


class BudgetedSimulator:
    """A simulator that refuses what could take it past a number of steps.

    Args:
        simulator: does the work.
        limit: of `steps`.
    """

    def __init__(self, simulator: TeamSimulator, limit: int) -> None:
        self._simulator = simulator
        self._limit = limit
        self.action_sizes = simulator.action_sizes
        self.observation_sizes = simulator.observation_sizes
        self.horizon = simulator.horizon
        self.copies = simulator.copies

    @property
    def episodes(self) -> int:
        """Simulated so far."""
        return self._simulator.episodes

    @property
    def steps(self) -> int:
        """Simulated so far."""
        return self._simulator.steps

    def returns(self, teams: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """See `TeamSimulator`; raises BudgetSpentError."""
        self._check(len(teams.action) * len(seeds))
        return self._simulator.returns(teams, seeds)

    def visits(self, team: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """See `TeamSimulator`; raises BudgetSpentError."""
        self._check(len(seeds))
        return self._simulator.visits(team, seeds)

    def experience(
        self, team: DecisionTables, agent: int, exploration: float, seeds: UInt64Array
    ) -> tuple[IntArray, FloatArray]:
        """See `TeamSimulator`; raises BudgetSpentError."""
        self._check(len(seeds))
        return self._simulator.experience(team, agent, exploration, seeds)

    def _check(self, seeds: int) -> None:
        if self.steps + seeds * self.copies * self.horizon > self._limit:
            raise BudgetSpentError


def effective_horizon(discount: float, max_episode_steps: int) -> int:
    """Steps after which no more than `TAIL` of the discounted weight is left, at most the limit."""
    if discount == 1.0:
        return max_episode_steps
    return min(max_episode_steps, math.ceil(math.log(TAIL) / math.log(discount)))


def simulator_of(env: Any, discount: float) -> TeamSimulator:
    """Make a simulator of an environment.

    Args:
        env: a tabular environment of this suite (one that has a `model`) or a `GridTrafficBatch`,
            which are simulated by compiled loops; any other vector environment without autoreset
            or PettingZoo parallel environment, which is stepped.
        discount: factor in (0, 1].

    Raises:
        ValueError: the environment has no limit of steps, or cannot be simulated.
    """
    from bnprl_agents.search.stepwise_simulator import StepwiseSimulator
    from bnprl_agents.search.tabular_simulator import TabularSimulator
    from bnprl_agents.search.traffic_simulator import TrafficSimulator

    limit = horizon_of(env)
    if limit is None:
        raise ValueError(
            f"environment: {type(env).__name__} says of no limit of steps, but the search needs "
            "one: max_episode_steps, or an attribute max_cycles of a PettingZoo environment"
        )
    model = getattr(env, "model", None)
    if isinstance(model, TabularModel):
        return TabularSimulator(model, discount=discount, max_episode_steps=limit)
    if isinstance(env, GridTrafficBatch):
        return TrafficSimulator(env, discount=discount, max_episode_steps=limit)
    return StepwiseSimulator(env, discount=discount, max_episode_steps=limit)
