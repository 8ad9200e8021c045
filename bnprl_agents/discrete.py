"""Discrete environments' values as (n, N) integer arrays: n copies, N agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from bnprl_agents.episodes import BoolArray, FloatArray, IntArray


class DiscreteSpaces:
    """Translates between what an environment exchanges and arrays of indices.

    A scalar is a batch of one, an array (n,) is a batch of one agent, a dict from agent to either
    is a team, and so is an array (n, N). Indices begin at 0 whatever the spaces' `start`.

    Args:
        observation_space: a Discrete space, or a dict of them for many agents.
        action_space: likewise, for the same agents.

    Raises:
        ValueError: a space is not Discrete, or the agents differ.
    """

    def __init__(self, observation_space: Any, action_space: Any) -> None:
        self.agents = tuple(action_space) if _is_team(action_space) else None
        if self.agents != (tuple(observation_space) if _is_team(observation_space) else None):
            raise ValueError("observation_space and action_space: must have the same agents")
        self._observation = _discrete("observation_space", observation_space, self.agents)
        self._action = _discrete("action_space", action_space, self.agents)
        self.observation_sizes = tuple(int(space.n) for space in self._observation)
        self.action_sizes = tuple(int(space.n) for space in self._action)

    def observations(self, value: Any) -> IntArray:
        """Indices (n, N) of observations as they come from the environment.

        Raises:
            ValueError: one is not an integer or lies outside its space.
        """
        return self._indices("observation", value, self._observation)

    def actions(self, value: Any) -> IntArray:
        """Indices (n, N) of actions as they go to the environment.

        Raises:
            ValueError: one is not an integer or lies outside its space.
        """
        return self._indices("action", value, self._action)

    def external_actions(self, actions: IntArray, like: Any) -> Any:
        """Turn action indices (n, N) into the form (dict, array or scalar) of `like`."""
        columns = [actions[:, n] + int(space.start) for n, space in enumerate(self._action)]
        if self.agents is None:
            return _unbatched(columns[0], like)
        if not isinstance(like, Mapping):
            return np.stack(columns, axis=1)
        return {
            agent: _unbatched(column, like[agent])
            for agent, column in zip(self.agents, columns, strict=True)
        }

    def shared(self, name: str, value: Any, dtype: type[Any]) -> Any:
        """Values (n,) that all agents share: reward, terminated or truncated.

        Raises:
            ValueError: they differ between agents.
        """
        if not isinstance(value, Mapping):
            return np.atleast_1d(np.asarray(value, dtype=dtype))
        columns = [
            np.atleast_1d(np.asarray(value[agent], dtype=dtype)) for agent in self.agents or ()
        ]
        if any((column != columns[0]).any() for column in columns):
            raise ValueError(f"{name}: differs between agents, but a team shares it: {dict(value)}")
        return columns[0]

    def reward(self, value: Any) -> FloatArray:
        """Team rewards (n,).

        Raises:
            ValueError: they differ between agents or one is not finite.
        """
        reward: FloatArray = self.shared("reward", value, np.float64)
        if not np.isfinite(reward).all():
            raise ValueError(f"reward: {reward[~np.isfinite(reward)][0]}, must be finite")
        return reward

    def flag(self, name: str, value: Any) -> BoolArray:
        """Booleans (n,) that all agents share."""
        flags: BoolArray = self.shared(name, value, np.bool_)
        return flags

    def _columns(self, name: str, value: Any) -> list[Any]:
        """Each agent's values."""
        if self.agents is None:
            return [value]
        if isinstance(value, Mapping):
            return [value[agent] for agent in self.agents]
        rows = np.asarray(value)
        if rows.ndim != 2 or rows.shape[1] != len(self.agents):
            raise ValueError(
                f"{name}: shape {rows.shape}, must be a dict or an array (n, {len(self.agents)})"
            )
        return list(rows.T)

    def _indices(self, name: str, value: Any, spaces: list[gym.spaces.Discrete]) -> IntArray:
        indices = np.stack(
            [
                _integers(name, column) - int(space.start)
                for column, space in zip(self._columns(name, value), spaces, strict=True)
            ],
            axis=1,
        )
        sizes = np.array([space.n for space in spaces])
        outside = (indices < 0) | (indices >= sizes)
        if outside.any():
            copy, agent = np.argwhere(outside)[0]
            raise ValueError(
                f"{name}: {indices[copy, agent] + spaces[agent].start} of agent {agent} lies "
                f"outside {spaces[agent]}"
            )
        return indices


def team_spaces(space: gym.Space[Any]) -> dict[str, gym.spaces.Discrete]:
    """Return the spaces of agent_0, agent_1, ..., one column each of a batch of teams.

    Raises:
        ValueError: the space is no MultiDiscrete.
    """
    if not isinstance(space, gym.spaces.MultiDiscrete):
        raise ValueError(f"space: {space}, must be a MultiDiscrete with one entry an agent")
    return {f"agent_{n}": gym.spaces.Discrete(int(size)) for n, size in enumerate(space.nvec)}


def _is_team(space: Any) -> bool:
    return isinstance(space, Mapping)


def _discrete(name: str, space: Any, agents: tuple[str, ...] | None) -> list[gym.spaces.Discrete]:
    spaces = [space] if agents is None else [space[agent] for agent in agents]
    for part in spaces:
        if not isinstance(part, gym.spaces.Discrete):
            hint = "; discretise a Box first" if isinstance(part, gym.spaces.Box) else ""
            raise ValueError(f"{name}: {part}, but this agent needs Discrete{hint}")
    return spaces


def _integers(name: str, column: Any) -> IntArray:
    """Whole numbers (n,); floating-point ones pass where nothing is lost."""
    values = np.atleast_1d(np.asarray(column))
    if values.dtype.kind in "iub":
        return values.astype(np.int64)
    if values.dtype.kind != "f":
        raise ValueError(f"{name}: {values.flat[0]!r} of type {values.dtype}, must be an integer")
    broken = ~np.isfinite(values) | (values != np.trunc(values))
    if broken.any():
        raise ValueError(f"{name}: {values[broken][0]}, must be an integer")
    return values.astype(np.int64)


def _unbatched(column: IntArray, like: Any) -> Any:
    return int(column[0]) if np.ndim(like) == 0 else column
