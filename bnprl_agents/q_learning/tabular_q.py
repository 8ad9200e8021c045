"""Q-learning on a table of the quantised state: QL-tab of chapter 3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numba import njit

from bnprl_agents.agent import Metrics
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.policy_files import Arrays
from bnprl_agents.q_learning.schedule import check_schedules, learning_rate
from bnprl_agents.value_learner import Transitions, ValueAgent, taken


@dataclass(frozen=True)
class TabularQConfig:
    """Settings of `TabularQ`. The source does not say what t counts: here, transitions."""

    bins: int = 10
    """Equal intervals of each dimension of a Box; a Discrete observation is its own cell."""
    initial_rate: float = 0.5
    """c of the learning rate c / t^a."""
    rate_exponent: float = 0.3
    """a of the learning rate; t is the number of the transition."""
    exploration_exponent: float = 0.3
    """b of the exploring probability t^-b at the t-th step."""
    low: tuple[float, ...] = ()
    """Lower ends of the range of a Box that is divided; (): its own. Beyond, the last cell goes on."""
    high: tuple[float, ...] = ()
    """Upper ends."""
    grid_columns: int = 0
    """Of no use: cells of a grid are cells of the table."""

    def __post_init__(self) -> None:
        check_schedules(self)
        if self.bins < 1:
            raise ValueError(f"bins: {self.bins}, must be at least 1")


class TabularQ(ValueAgent):
    """Q-learning (Watkins 1989) whose table has a row for each cell of the state.

    Paper: dissertation, section 3.5 and appendix 3.7.1 (QL-tab).

    Attributes:
        table: (cells, A) action values.
    """

    Config = TabularQConfig
    config: TabularQConfig
    bounded = True

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: TabularQConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self._discrete = isinstance(observation_space, gym.spaces.Discrete)
        self._one_hot = self._discrete and not self.config.grid_columns
        n_cells = (
            int(observation_space.n)
            if self._discrete
            else self.config.bins**self.features.dimensions
        )
        if n_cells > 10**7:
            raise ValueError(
                f"bins: {self.config.bins} in {self.features.dimensions} dimensions make "
                f"{n_cells:,} cells, must be at most 10,000,000"
            )
        self.table = np.zeros((n_cells, self.n_actions))

    def values(self, points: FloatArray) -> FloatArray:
        """Return the rows (n, A) of the cells of points (n, D)."""
        rows: FloatArray = self.table[self.cells(points)]
        return rows

    def cells(self, points: FloatArray) -> IntArray:
        """Return the cells (n,) of points (n, D)."""
        if self._one_hot:
            return points.argmax(axis=1)
        if self._discrete:
            grid = points.astype(np.int64)
            return grid[:, 0] * self.config.grid_columns + grid[:, 1]
        bins = self.config.bins
        index = np.clip((points * bins).astype(np.int64), 0, bins - 1)
        cells: IntArray = index @ bins ** np.arange(self.features.dimensions)
        return cells

    def learn(self, transitions: Transitions) -> Metrics:
        """Q(s, a) += rate (r + gamma max_b Q(s', b) - Q(s, a)), one after the other."""
        error = learn_table(
            self.table,
            self.cells(transitions.points),
            transitions.actions,
            transitions.rewards,
            self.cells(transitions.next_points),
            transitions.terminated,
            self.discount,
            self.config.initial_rate,
            self.config.rate_exponent,
            self.steps,
        )
        return {"td_error": float(error), "exploring": self.exploring_probability()}

    def learned_arrays(self) -> Arrays:
        """The table."""
        return {"table": self.table}

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over a saved table."""
        self.table = taken(arrays, "table", self.table.shape)


@njit(cache=True)
def learn_table(  # type: ignore[no-untyped-def]
    table, cells, actions, rewards, next_cells, terminated, discount, initial_rate, exponent, steps
):
    """Learn transitions in order; return the mean of |delta|."""
    total = 0.0
    for i in range(actions.size):
        y = rewards[i]
        if not terminated[i]:
            y += discount * table[next_cells[i]].max()
        delta = y - table[cells[i], actions[i]]
        table[cells[i], actions[i]] += learning_rate(initial_rate, exponent, steps + i) * delta
        total += abs(delta)
    return total / actions.size
