"""What every controller learner shares: exploring, sampling, saving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bnprl_agents.controllers.controller import (
    Controller,
    random_controller,
    restored_team,
)
from bnprl_agents.controllers.exploration import exploring_probability, team_exploring
from bnprl_agents.controllers.filtering import mean_before_acting
from bnprl_agents.controllers.messages import Messages
from bnprl_agents.controllers.rollout import check_fit, rollout
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.history_agent import HistoryAgent
from bnprl_agents.policy_files import Arrays
from bnprl_agents.training import Budget, Progress
from bnprl_envs.horizon import horizon_of
from bnprl_envs.model import TabularModel


class NegativeRewardError(ValueError):
    """A reward below what the learner can use.

    Attributes:
        shift: the smallest reward_shift that would do.
    """

    def __init__(self, reward: float) -> None:
        self.shift = -reward
        super().__init__(
            f"reward: {reward:g}, but this learner multiplies with rewards, which must not be "
            f"negative: reward_shift={self.shift:g} would do"
        )


class ControllerAgent(HistoryAgent):
    """Base of the learners of finite-state controllers, for one agent and for teams.

    Subclasses say how a batch of episodes changes the controllers (`learn`). Every agent of a
    team acts on its own history only.

    Attributes:
        controllers: the learned policy, one controller an agent.
        explore: for each agent (Z,), the probability of a uniformly random action in each node.
    """

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
        self.controllers = self.initial_controllers()
        self.explore = tuple(np.ones(c.n_nodes) for c in self.controllers)

    def train_in(self, env: Any, budget: Budget, seed: int) -> Iterator[Progress]:
        """Learn from whole episodes; see `HistoryAgent.train_in`.

        Raises:
            ValueError: as there, or the discount is 1 and episodes may last for ever.
        """
        if self.discount == 1.0 and horizon_of(env) is None:
            raise ValueError(
                "discount: 1, but the environment has no horizon, so that returns may have no "
                "bound; give it max_episode_steps, or the agent a discount below 1"
            )
        return super().train_in(env, budget, seed)

    def check_model(self, model: TabularModel) -> None:
        """Check sizes too; see `HistoryAgent.check_model`."""
        check_fit(model, self.controllers)
        super().check_model(model)

    def sample(
        self, model: TabularModel, *, episodes: int, horizon: int, rng: np.random.Generator
    ) -> EpisodeBatch:
        """Sample whole episodes of a model by the compiled rollout, exploring."""
        return rollout(
            model,
            self.controllers,
            episodes=episodes,
            horizon=horizon,
            rng=rng,
            explore=self.explore,
        )

    def batch_share(self, episodes: EpisodeBatch) -> float:
        """The part of a whole batch that these episodes are, at most 1."""
        return min(1.0, episodes.n_episodes / self.batch_episodes)

    def check_reward(self, smallest: float) -> None:
        """Check that the learner can use rewards down to this one.

        Raises:
            NegativeRewardError: it has a reward_shift, and the shifted reward is negative.
        """
        if smallest + getattr(self.config, "reward_shift", np.inf) < 0.0:
            raise NegativeRewardError(smallest)

    def initial_controllers(self) -> tuple[Controller, ...]:
        """Random controllers with `config.nodes` nodes; successor rows are the sparse ones."""
        return tuple(
            random_controller(
                self.config.nodes,
                n_actions,
                n_observations,
                self.rng,
                self.config.successor_concentration,
            )
            for n_actions, n_observations in zip(
                self.spaces.action_sizes, self.spaces.observation_sizes, strict=True
            )
        )

    def begin(self, seen: IntArray) -> list[FloatArray]:
        """Node distributions after first observations; see `HistoryAgent.begin`."""
        return [c.begin(seen[:, n]) for n, c in enumerate(self.controllers)]

    def advance(
        self, beliefs: Sequence[FloatArray], actions: IntArray, seen: IntArray
    ) -> list[FloatArray]:
        """Node distributions after a step; see `HistoryAgent.advance`."""
        return [
            c.advance(belief, actions[:, n], seen[:, n])
            for n, (c, belief) in enumerate(zip(self.controllers, beliefs, strict=True))
        ]

    def policy_probabilities(
        self, beliefs: Sequence[FloatArray], seen: IntArray
    ) -> list[FloatArray]:
        """The controllers' probabilities; see `HistoryAgent.policy_probabilities`."""
        return [
            c.action_probabilities(belief)
            for c, belief in zip(self.controllers, beliefs, strict=True)
        ]

    def behaviour_probabilities(self) -> list[FloatArray]:
        """For each agent (n, A): the controller mixed with uniform exploration, (2.46)."""
        probabilities = []
        for exploit, belief, explore in zip(
            self.policy_probabilities(self._belief, self._seen),
            self._belief,
            self.explore,
            strict=True,
        ):
            exploring = (belief @ explore)[:, None]
            probabilities.append((1.0 - exploring) * exploit + exploring / exploit.shape[1])
        return probabilities

    def set_exploration(self, occupancies: Sequence[FloatArray]) -> None:
        """Draw the nodes' exploration anew from their value-weighted occupancies (Z,)."""
        self.explore = tuple(
            exploring_probability(occupancy, self.config.exploration_prior, self.rng)
            for occupancy in occupancies
        )

    def exploring_share(self, episodes: EpisodeBatch, messages: Sequence[Messages]) -> float:
        """Mean probability, given the history, that the team explores at a step; (6.17)."""
        each = [
            mean_before_acting(episodes, n, controller, message, explore)
            for n, (controller, message, explore) in enumerate(
                zip(self.controllers, messages, self.explore, strict=True)
            )
        ]
        return float(team_exploring(np.stack(each, axis=1)).mean())

    def state_arrays(self) -> Arrays:
        """Controllers, exploration, beliefs and what is recorded."""
        arrays = super().state_arrays()
        for n, (controller, explore) in enumerate(zip(self.controllers, self.explore, strict=True)):
            arrays |= {f"{name}_{n}": table for name, table in vars(controller).items()}
            arrays[f"explore_{n}"] = explore
        return arrays

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        sizes = self.spaces.action_sizes, self.spaces.observation_sizes
        self.controllers, self.explore = restored_team(arrays, "{}_", *sizes)
        for n, controller in enumerate(self.controllers):
            for name, table in vars(controller).items():
                if np.abs(table.sum(axis=-1) - 1.0).max() > 1e-6:
                    raise ValueError(f"a row of {name}_{n} does not sum to 1")
        super().restore(arrays, counters)

    def check_nodes(self, nodes: int) -> None:
        """Check the size of controllers from a policy file (ValueError)."""
        for n, controller in enumerate(self.controllers):
            if controller.n_nodes != nodes:
                raise ValueError(f"action_{n}: {controller.n_nodes} nodes, must be {nodes}")


def check_shift(shift: float) -> None:
    """Check a setting reward_shift.

    Raises:
        ValueError: it is negative, with which a terminal state would earn negative rewards for
            ever, or not finite.
    """
    if not 0.0 <= shift < np.inf:
        raise ValueError(f"reward_shift: {shift}, must be finite, not negative")


def shifted(episodes: EpisodeBatch, shift: float, discount: float) -> EpisodeBatch:
    """Add a constant to every reward without changing which policy is best.

    A terminal state goes on earning the shift for ever, so that ending early gains or loses
    nothing: the last reward of a terminated episode gets shift * discount / (1 - discount) more.

    Args:
        episodes: K episodes.
        shift: amount to add, at least minus the smallest reward.
        discount: factor in (0, 1); 1 serves where no episode has terminated.

    Raises:
        ValueError: a terminal state would earn an infinite shift.
    """
    if shift == 0.0:
        return episodes
    if discount == 1.0 and episodes.terminated.any():
        raise ValueError(
            f"reward_shift: {shift:g}, with a discount of 1 a terminal state would earn it for "
            "ever; take a discount below 1, or rewards that are not negative"
        )
    rewards = episodes.rewards + shift
    if discount < 1.0:
        rewards[episodes.offsets[1:][episodes.terminated] - 1] += (
            shift * discount / (1.0 - discount)
        )
    return EpisodeBatch(**(vars(episodes) | {"rewards": rewards}))
