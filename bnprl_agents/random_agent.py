"""Uniformly random actions: the floor of every comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller, uniform_controller
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.discrete import DiscreteSpaces
from bnprl_agents.episodes import EpisodeBatch, IntArray


@dataclass(frozen=True)
class RandomConfig:
    """`RandomAgent` has no settings."""


class UnseenBox(DiscreteSpaces):
    """A Box that nobody looks at: all its observations have one index.

    Args:
        observation_space: the Box.
        action_space: a Discrete space.
    """

    def __init__(self, observation_space: gym.spaces.Box, action_space: Any) -> None:
        super().__init__(gym.spaces.Discrete(1), action_space)
        self._axes = len(observation_space.shape)

    def observations(self, value: Any) -> IntArray:
        """Zeros (n, 1)."""
        return np.zeros((np.shape(value)[0] if self._batched(value) else 1, 1), dtype=np.int64)

    def external_actions(self, actions: IntArray, like: Any) -> Any:
        """Turn action indices (n, 1) into an array (n,), or one action for one observation."""
        found = super().external_actions(actions, actions[:, 0])
        return found if self._batched(like) else int(found[0])

    def _batched(self, value: Any) -> bool:
        return np.ndim(value) > self._axes


class RandomAgent(ControllerAgent):
    """Chooses uniformly among the actions: a controller of one node that never learns."""

    Config = RandomConfig

    def translate(self, observation_space: Any, action_space: Any) -> DiscreteSpaces:
        """Any Box will do for an observation; see `HistoryAgent.translate`."""
        if isinstance(observation_space, gym.spaces.Box):
            return UnseenBox(observation_space, action_space)
        return super().translate(observation_space, action_space)

    @property
    def batch_episodes(self) -> int:
        """Episodes between two reports."""
        return 100

    def initial_controllers(self) -> tuple[Controller, ...]:
        """One node with uniform actions."""
        return tuple(
            map(uniform_controller, self.spaces.action_sizes, self.spaces.observation_sizes)
        )

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Learn nothing; returns the mean return."""
        return {"return_mean": float(episodes.returns(self.discount).mean())}
