"""Discrete environments' values as (n, N) integer arrays: n copies, N agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from bnprl_agents.copies import integers
from bnprl_agents.episodes import BoolArray, FloatArray, IntArray


class DiscreteSpaces:
    """Translates between what an environment exchanges and arrays of indices.

    Of one agent: an array (n,), or a scalar, which is a batch of one. Of a team: a dict from agent
    to either, as in PettingZoo, or an array (n, N) or (N,) in the order of the agents, as in the
    batches of `bnprl_envs`. Indices begin at 0 whatever the spaces' `start`.

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
        self._action_starts = np.array([space.start for space in self._action])
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
        external = actions + self._action_starts
        if isinstance(like, Mapping):
            columns = zip(self.agents or (), external.T, strict=True)
            return {agent: _unbatched(column, like[agent]) for agent, column in columns}
        if self.agents is None:
            return _unbatched(external[:, 0], like)
        return external[0] if np.ndim(like) == 1 else external

    def shared(self, name: str, value: Any, dtype: type[Any]) -> Any:
        """Values (n,) that all agents share: reward, terminated or truncated.

        Raises:
            ValueError: they differ between agents, or are not one for each copy.
        """
        if not isinstance(value, Mapping):
            given = np.atleast_1d(np.asarray(value, dtype=dtype))
            if given.ndim != 1:
                raise ValueError(f"{name}: shape {given.shape}, must be one for each copy, (n,)")
            return given
        rows = self._stacked(name, value).astype(dtype)
        if (rows != rows[:, :1]).any():
            raise ValueError(f"{name}: differs between agents, but a team shares it: {dict(value)}")
        return rows[:, 0]

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

    def _indices(self, name: str, value: Any, spaces: list[gym.spaces.Discrete]) -> IntArray:
        starts = np.array([space.start for space in spaces])
        indices: IntArray = integers(name, self._rows(name, value)) - starts
        outside = (indices < 0) | (indices >= [space.n for space in spaces])
        if outside.any():
            copy, agent = np.argwhere(outside)[0]
            raise ValueError(
                f"{name}: {indices[copy, agent] + spaces[agent].start} of agent {agent} lies "
                f"outside {spaces[agent]}"
            )
        return indices

    def _rows(self, name: str, value: Any) -> Any:
        """A value as the environment gave it, as an array (n, N)."""
        given = np.asarray(self._stacked(name, value) if isinstance(value, Mapping) else value)
        rows = np.atleast_1d(given)[:, None] if self.agents is None else np.atleast_2d(given)
        n_agents = len(self.action_sizes)
        if rows.ndim != 2 or rows.shape[1] != n_agents:
            team = f"({n_agents},) or (n, {n_agents})"
            form = "a number or (n,)" if self.agents is None else team
            raise ValueError(f"{name}: shape {given.shape}, must be {form}")
        return rows

    def _stacked(self, name: str, value: Mapping[str, Any]) -> Any:
        """A dict from agent to a value or (n,) of them, as an array (n, N)."""
        if self.agents is None or set(value) != set(self.agents):
            wanted = ", ".join(self.agents) if self.agents else "none: there is one agent"
            raise ValueError(f"{name}: of agents {', '.join(map(str, value))}, must be {wanted}")
        columns = [np.atleast_1d(value[agent]) for agent in self.agents]
        if len({column.shape for column in columns}) > 1:
            raise ValueError(f"{name}: shapes differ between agents")
        return np.stack(columns, axis=1)


def _is_team(space: Any) -> bool:
    return isinstance(space, Mapping)


def _discrete(name: str, space: Any, agents: tuple[str, ...] | None) -> list[gym.spaces.Discrete]:
    spaces = [space] if agents is None else [space[agent] for agent in agents]
    for part in spaces:
        if not isinstance(part, gym.spaces.Discrete):
            wrapper = f"Discretize{name.removesuffix('_space').title()}"
            box = isinstance(part, gym.spaces.Box)
            hint = f"; discretise a Box first: gymnasium.wrappers.{wrapper}(env, 10)" if box else ""
            raise ValueError(f"{name}: {part}, but this agent needs Discrete{hint}")
    return spaces


def _unbatched(column: IntArray, like: Any) -> Any:
    return int(column[0]) if np.ndim(like) == 0 else column
