"""What learners of belief policies share: acting, recording, saving."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np

from bnprl_agents.agent import Agent, Metrics
from bnprl_agents.belief.policy import BeliefPolicy
from bnprl_agents.belief.rollout import belief_rollout
from bnprl_agents.controllers.learner import PolicyState
from bnprl_agents.discrete import DiscreteSpaces
from bnprl_agents.episodes import BoolArray, EpisodeBatch, FloatArray, IntArray
from bnprl_agents.policy_files import Arrays
from bnprl_agents.recorder import EpisodeRecorder
from bnprl_envs.model import TabularModel


class BeliefAgent(Agent):
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
        self.spaces = DiscreteSpaces(observation_space, action_space)
        if self.spaces.agents is not None:
            raise ValueError("action_space: of several agents, but this learner serves one")
        self.n_actions = self.spaces.action_sizes[0]
        self.n_observations = self.spaces.observation_sizes[0]
        self._recorder = EpisodeRecorder(1)
        self._belief = np.zeros((0, self.n_features))
        self._seen = np.zeros((0, 1), dtype=np.int64)
        self._alive = np.zeros(0, dtype=np.bool_)

    @abc.abstractmethod
    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Improve the policy by a batch of episodes."""

    @property
    @abc.abstractmethod
    def batch_episodes(self) -> int:
        """Episodes that one call of `learn` wants; the last of a budget may get fewer."""

    def sample(
        self, model: TabularModel, *, episodes: int, horizon: int, rng: np.random.Generator
    ) -> EpisodeBatch:
        """Sample whole episodes of a model by the compiled rollout."""
        return belief_rollout(model, self.policy, episodes=episodes, horizon=horizon, rng=rng)

    def reset(self, observation: Any, mask: BoolArray | None = None) -> None:
        """Begin new episodes; see `Agent.reset`. The number of copies may change if all begin."""
        seen = self.spaces.observations(observation)
        begun = np.ones(len(seen), dtype=np.bool_) if mask is None else np.asarray(mask, bool)
        if begun.shape != (len(seen),):
            raise ValueError(f"mask: shape {begun.shape}, must be ({len(seen)},)")
        if len(seen) != len(self._alive):
            if not begun.all():
                raise ValueError(f"{len(seen)} copies, was {len(self._alive)}: reset all of them")
            self._belief = np.zeros((len(seen), self.n_features))
            self._seen, self._alive = seen.copy(), begun.copy()
        self._recorder.begin(begun)
        self._seen[begun] = seen[begun]
        self._alive |= begun
        self._belief[begun] = self.policy.begin(seen[begun, 0])

    def act(self, observation: Any) -> Any:
        """Sample actions from the policy; see `Agent.act`."""
        self._require_alive()
        p = self.policy.action_probabilities(self._belief, self._seen[:, 0])
        return self.spaces.external_actions(_sample(p, self.rng)[:, None], observation)

    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition with its behaviour probability; see `Agent.observe`."""
        self._require_alive()
        actions, seen = self.spaces.actions(action), self.spaces.observations(observation)
        ended = self.spaces.flag("terminated", terminated)
        cut = self.spaces.flag("truncated", truncated)
        p = self.policy.action_probabilities(self._belief, self._seen[:, 0])
        behaviour = np.take_along_axis(p, actions, axis=1)
        self._recorder.add(
            self._seen, actions, self.spaces.reward(reward), behaviour, seen, ended, cut
        )
        self._belief = self.policy.advance(self._belief, actions[:, 0], seen[:, 0])
        self._seen = seen
        self._alive = ~(ended | cut)

    def update(self) -> Metrics:
        """Learn once `batch_episodes` episodes are finished; see `Agent.update`."""
        if self._recorder.n_finished < self.batch_episodes:
            return {}
        return self.learn(self._recorder.take())

    def finish(self) -> Metrics:
        """Learn from the finished episodes, fewer than a batch; see `Agent.finish`."""
        return self.learn(self._recorder.take()) if self._recorder.n_finished else {}

    def predict(
        self,
        observation: Any,
        state: PolicyState | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, PolicyState]:
        """Act on the belief; see `Agent.predict`."""
        seen = self.spaces.observations(observation)[:, 0]
        belief = self._predicted_belief(seen, state, episode_start)
        p = self.policy.action_probabilities(belief, seen)
        chosen = (p.argmax(axis=1) if deterministic else _sample(p, self.predict_rng))[:, None]
        return self.spaces.external_actions(chosen, observation), PolicyState(belief, chosen)

    def _predicted_belief(
        self, seen: IntArray, state: PolicyState | None, episode_start: Any
    ) -> FloatArray:
        begun = self.policy.begin(seen)
        if state is None:
            return begun
        fresh = np.zeros(len(seen), dtype=np.bool_)
        if episode_start is not None:
            fresh |= np.asarray(episode_start, dtype=np.bool_)
        belief = np.asarray(state.belief)
        return np.where(
            fresh[:, None], begun, self.policy.advance(belief, state.action[:, 0], seen)
        )

    def state_arrays(self) -> Arrays:
        """Beliefs and what is recorded."""
        arrays: Arrays = {"seen": self._seen, "alive": self._alive, "belief": self._belief}
        return arrays | self._recorder.state_arrays()

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        self._belief = arrays["belief"]
        self._seen, self._alive = arrays["seen"], arrays["alive"]
        self._recorder.restore(arrays)

    def _require_alive(self) -> None:
        if not self._alive.size or not self._alive.all():
            raise RuntimeError(
                "an episode has ended or none has begun: call reset(observation, mask) first"
            )


def _sample(probabilities: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw one index a row of (n, A)."""
    cumulative = np.cumsum(probabilities, axis=1)
    uniform = rng.random(len(cumulative))[:, None] * cumulative[:, -1:]
    index: IntArray = np.argmax(cumulative > uniform, axis=1)
    return index
