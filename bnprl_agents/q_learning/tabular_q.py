"""Q-learning on a table of the quantised state: QL-tab of chapter 3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numba import njit

from bnprl_agents.agent import Metrics
from bnprl_agents.compiled_values import CompiledValueAgent, register
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.q_learning.schedule import check_schedules, learning_rate
from bnprl_agents.settings import Settings, check_entries

MOST_CELLS = 10**7
"""Largest table."""


@dataclass(frozen=True)
class TabularQConfig(Settings):
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
    """Lower ends of the range of a Box that is divided; (): its own. Outer cells go on beyond."""
    high: tuple[float, ...] = ()
    """Upper ends."""
    grid_columns: int = 0
    """Columns of the grid whose cells a Discrete observation counts row by row, as pictures show
    it; the table does not depend on it. 0: none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_schedules(self)
        if self.bins < 1:
            raise ValueError(f"bins: {self.bins}, must be at least 1")


class Table(NamedTuple):
    """Everything that the compiled functions read and change.

    Attributes:
        values: (cells, A).
        scale: (D,) cells of each dimension for a unit of the point.
        largest: (D,) the last cell of each dimension.
        stride: (D,) cells from one cell of each dimension to the next.
        discount: gamma.
        initial_rate: c of the learning rate c / t^a.
        rate_exponent: a.
    """

    values: FloatArray
    scale: FloatArray
    largest: IntArray
    stride: IntArray
    discount: float
    initial_rate: float
    rate_exponent: float


class TabularQ(CompiledValueAgent):
    """Q-learning (Watkins 1989) whose table has a row for each cell of the state.

    Paper: dissertation, section 3.5 and appendix 3.7.1 (QL-tab).

    Attributes:
        table: (cells, A) action values.
    """

    Config = TabularQConfig
    config: TabularQConfig
    needs_distance = False

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
        self._scale, self._largest, self._stride = self._division(observation_space)
        n_cells = int(self._largest @ self._stride) + 1
        check_entries("observation_space, action_space", n_cells, self.n_actions)
        self.table = np.zeros((n_cells, self.n_actions))

    @property
    def learner(self) -> Table:
        """The table as it stands."""
        return Table(
            self.table,
            self._scale,
            self._largest,
            self._stride,
            self.discount,
            self.config.initial_rate,
            self.config.rate_exponent,
        )

    def values(self, points: FloatArray) -> FloatArray:
        """Return the rows (n, A) of the cells of points (n, D)."""
        return self.behaviour_values(points)

    def report(self, error: float) -> Metrics:
        """Report errors and the exploration."""
        return {"td_error": error, "exploring": self.exploring_probability()}

    def _division(self, space: gym.Space[Any]) -> tuple[FloatArray, IntArray, IntArray]:
        """Return scale, largest cell and stride (D,) of every dimension."""
        dimensions = self.features.dimensions
        if not isinstance(space, gym.spaces.Discrete):
            bins = self.config.bins
            if bins**dimensions > MOST_CELLS:
                raise ValueError(
                    f"bins: {bins} in {dimensions} dimensions are more than {MOST_CELLS:,} cells"
                )
            return (
                np.full(dimensions, float(bins)),
                np.full(dimensions, bins - 1),
                bins ** np.arange(dimensions),
            )
        largest = self.features.high.astype(np.int64)
        stride = np.array([self.features.columns, 1]) if self.features.columns else np.ones(1, int)
        return np.ones(dimensions), largest, stride

    def learned_arrays(self) -> Arrays:
        """The table."""
        return {"table": self.table}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        if self.features.numbered:
            arrays = _numbered(arrays, len(self.table))
        super().restore(arrays, counters)

    def restore_learned(self, arrays: Arrays) -> None:
        """Take over a saved table."""
        self.table = taken(arrays, "table", self.table.shape)


def _numbered(arrays: Arrays, n: int) -> Arrays:
    """Arrays of a policy file that may be of a time when n values were corners of a simplex."""
    corners = [
        name for name, a in arrays.items() if name.endswith("points") and a.shape[1:] == (n,)
    ]
    numbers = {name: arrays[name].argmax(axis=1)[:, None] for name in corners if n > 1}
    return arrays | numbers | {"table": arrays["table"][:n]}  # it had rows to spare


@njit(cache=True)
def cell(table, x):  # type: ignore[no-untyped-def]
    """Return the cell of a point (D,)."""
    number = 0
    for d in range(x.size):
        place = x[d] * table.scale[d]
        if place >= table.largest[d]:
            number += table.largest[d] * table.stride[d]
        elif place > 0.0:
            number += int(place) * table.stride[d]
    return number


@njit(cache=True)
def row(table, x):  # type: ignore[no-untyped-def]
    """Return the values (A,) at a point."""
    return table.values[cell(table, x)]


@njit(cache=True)
def learn_cell(table, x, a, r, x_t, terminated, t):  # type: ignore[no-untyped-def]
    """Q(s, a) += rate (r + gamma max_b Q(s', b) - Q(s, a))."""
    y = r
    if not terminated:
        y += table.discount * row(table, x_t).max()
    delta = y - row(table, x)[a]
    row(table, x)[a] += learning_rate(table.initial_rate, table.rate_exponent, t) * delta
    return abs(delta)


register(Table, row, learn_cell)
