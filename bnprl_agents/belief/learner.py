"""What learners of belief policies share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bnprl_agents.belief.policy import BeliefPolicy
from bnprl_agents.belief.rollout import belief_rollout
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.history_agent import HistoryAgent
from bnprl_envs.model import TabularModel


class BeliefAgent(HistoryAgent):
    """Base of the learners of a `BeliefPolicy`, for one agent with discrete spaces.

    Attributes:
        policy: the learned policy, which explores by being stochastic.
    """

    policy: BeliefPolicy

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        if self.spaces.agents is not None:
            raise ValueError("action_space: of several agents, but this learner serves one")
        self.n_actions = self.spaces.action_sizes[0]
        self.n_observations = self.spaces.observation_sizes[0]

    def sample(
        self, model: TabularModel, *, episodes: int, horizon: int, rng: np.random.Generator
    ) -> EpisodeBatch:
        """Sample whole episodes of a model by the compiled rollout."""
        return belief_rollout(model, self.policy, episodes=episodes, horizon=horizon, rng=rng)

    def begin(self, seen: IntArray) -> list[FloatArray]:
        """Beliefs after first observations; see `HistoryAgent.begin`."""
        return [self.policy.begin(seen[:, 0])]

    def advance(
        self, beliefs: Sequence[FloatArray], actions: IntArray, seen: IntArray
    ) -> list[FloatArray]:
        """Beliefs after a step; see `HistoryAgent.advance`."""
        return [self.policy.advance(beliefs[0], actions[:, 0], seen[:, 0])]

    def policy_probabilities(
        self, beliefs: Sequence[FloatArray], seen: IntArray
    ) -> list[FloatArray]:
        """The policy's probabilities; see `HistoryAgent.policy_probabilities`."""
        return [self.policy.action_probabilities(beliefs[0], seen[:, 0])]
