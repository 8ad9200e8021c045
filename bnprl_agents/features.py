"""Observations as points of a space with a distance, for kernels, bases and tables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import gymnasium as gym
import numpy as np

from bnprl_agents.copies import integers
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.settings import check_entries


class Features:
    """Turns observations of one agent into points (n, D).

    A Box becomes shares of its range: 0 at its lower and 1 at its upper end. A Discrete space has
    no distance of its own: its values are the cells of a grid, row by row, where the number of
    columns is given (points (row, column)), else the corners of a simplex, all equally far. Whoever
    needs no distance takes their numbers, counted from 0.

    Args:
        space: Discrete, or a Box.
        low: replaces the lower end of the Box, one number for each dimension; (): not.
        high: the upper end.
        grid_columns: columns of the grid whose cells the values of a Discrete space are; 0: none.
        numbered: without a grid, points of a Discrete space are its values' numbers, (n, 1).

    Attributes:
        dimensions: D.
        low, high: (D,) ends of the range in units of the observation.
        columns: of the grid; 0: there is none.
        numbered: whether points are numbers.
        offset, range: (D,) of a Box or of numbers, whose points are (state - offset) / range.

    Raises:
        ValueError: another kind of space, a Box with an infinite end that neither `low` nor `high`
            replaces, the settings do not fit the space, or a simplex would need too much memory.
    """

    def __init__(
        self,
        space: gym.Space[Any],
        low: Sequence[float] = (),
        high: Sequence[float] = (),
        grid_columns: int = 0,
        *,
        numbered: bool = False,
    ) -> None:
        if grid_columns < 0:
            raise ValueError(f"grid_columns: {grid_columns}, must not be negative")
        self.space = space
        self.columns, self.numbered = 0, False
        if isinstance(space, gym.spaces.Discrete):
            if low or high:
                raise ValueError("low, high: are of a Box; the observation space is Discrete")
            n = int(space.n)
            self.columns, self.numbered = min(grid_columns, n), numbered and not grid_columns
            self.high = self._largest(n)
            self.low = np.zeros_like(self.high)
            self.offset, self.range = np.zeros(1), np.ones(1)
        elif isinstance(space, gym.spaces.Box):
            if grid_columns:
                raise ValueError("grid_columns: is of a Discrete space; the observation is a Box")
            self.low = _ends("low", low, space.low)
            self.high = _ends("high", high, space.high)
            self._check_box()
            self.offset, self.range = self.low, self.high - self.low
        else:
            raise ValueError(f"observation_space: {space}, must be Discrete or Box")
        self.dimensions = self.low.size

    def __call__(self, observation: Any) -> FloatArray:
        """Return observations (n, ...), or one, as points (n, D).

        Raises:
            ValueError: one is not finite, has another shape or lies outside a Discrete space.
        """
        if isinstance(self.space, gym.spaces.Discrete):
            return self._placed(self._cells(observation, self.space), int(self.space.n))
        array = np.asarray(observation, dtype=np.float64)
        shape = self.space.shape or ()
        if array.shape[max(array.ndim - len(shape), 0) :] != shape or array.ndim > len(shape) + 1:
            raise ValueError(
                f"observation: shape {array.shape}, must be {shape}, or have copies in front of it"
            )
        array = array.reshape(-1, self.dimensions)
        if not np.isfinite(array).all():
            raise ValueError(f"observation: {array[~np.isfinite(array)][0]}, must be finite")
        return (array - self.offset) / self.range

    @cached_property
    def points(self) -> FloatArray:
        """(n, D) of the values of a Discrete space; (0, D) of a Box, and of mere numbers.

        Raises:
            ValueError: they need too much memory.
        """
        if not isinstance(self.space, gym.spaces.Discrete) or self.numbered:
            return np.zeros((0, self.dimensions))
        n = int(self.space.n)
        check_entries("observation_space", n, self.dimensions)
        return self._placed(np.arange(n), n)

    def batched(self, observation: Any) -> bool:
        """Whether this is a batch of observations."""
        return np.ndim(observation) > len(self.space.shape or ())

    def _largest(self, n: int) -> FloatArray:
        """Largest coordinates (D,) of the n values of a Discrete space."""
        if self.columns:
            return np.array([(n - 1) // self.columns, self.columns - 1.0])
        if self.numbered:
            return np.array([n - 1.0])
        check_entries("observation_space", n, n)
        return np.ones(n)

    def _placed(self, cells: IntArray, n: int) -> FloatArray:
        """Points (m, D) of some of the n values of a Discrete space, given their numbers (m,)."""
        if self.columns:
            return np.stack(np.divmod(cells, self.columns), axis=1).astype(np.float64)
        if self.numbered:
            return cells[:, None].astype(np.float64)
        return np.equal.outer(cells, np.arange(n)).astype(np.float64)

    def _cells(self, observation: Any, space: gym.spaces.Discrete) -> Any:
        cells = integers("observation", np.atleast_1d(observation)) - int(space.start)
        if cells.ndim > 1:
            raise ValueError(f"observation: shape {cells.shape}, must be a number or (n,)")
        if ((cells < 0) | (cells >= space.n)).any():
            raise ValueError(f"observation: {observation} lies outside {space}")
        return cells

    def _check_box(self) -> None:
        if (self.low >= self.high).any():
            raise ValueError(f"low: {self.low.tolist()}, must be below high: {self.high.tolist()}")
        if not np.isfinite([self.low, self.high]).all():
            raise ValueError(
                f"observation_space: {self.space} has infinite bounds; give low and high"
            )


def _ends(name: str, given: Sequence[float], own: Any) -> FloatArray:
    if not given:
        return np.asarray(own, dtype=np.float64).ravel()
    ends = np.array(given, dtype=np.float64)
    if ends.shape != (own.size,) or not np.isfinite(ends).all():
        raise ValueError(f"{name}: {tuple(given)}, must be {own.size} finite numbers")
    return ends
