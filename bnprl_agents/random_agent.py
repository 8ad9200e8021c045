"""Uniformly random actions: the floor of every comparison."""

from __future__ import annotations

from dataclasses import dataclass

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller, uniform_controller
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.episodes import EpisodeBatch


@dataclass(frozen=True)
class RandomConfig:
    """`RandomAgent` has no settings."""


class RandomAgent(ControllerAgent):
    """Chooses uniformly among the actions: a controller of one node that never learns."""

    Config = RandomConfig

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
