"""What learners share that act on beliefs about their history: acting, recording, saving."""

from __future__ import annotations

import abc
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from bnprl_agents.agent import Agent, Metrics
from bnprl_agents.copies import check_copies, require_alive
from bnprl_agents.discrete import DiscreteSpaces
from bnprl_agents.episodes import (
    BoolArray,
    EpisodeBatch,
    FloatArray,
    IntArray,
    check_episodes,
    check_range,
)
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.recorder import EpisodeRecorder
from bnprl_agents.training import Budget, Progress, check_batch
from bnprl_envs.horizon import horizon_of
from bnprl_envs.model import TabularModel


class PolicyState(NamedTuple):
    """What `predict` remembers of n copies.

    Attributes:
        belief: (n, Z) belief after the last observation, a tuple of them for a team.
        action: (n, N) last action indices.
    """

    belief: FloatArray | tuple[FloatArray, ...]
    action: IntArray


class HistoryAgent(Agent):
    """Base of the learners whose agents act on a belief about their own history.

    Subclasses say how beliefs begin, advance and choose, and how a batch of whole episodes changes
    the policy (`learn`). One agent is a team of one.
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
        self.spaces = self.translate(observation_space, action_space)
        n_agents = len(self.spaces.action_sizes)
        self._recorder = EpisodeRecorder(n_agents)
        self._belief: list[FloatArray] = []
        self._seen = np.zeros((0, n_agents), dtype=np.int64)
        self._alive = np.zeros(0, dtype=np.bool_)

    def translate(self, observation_space: Any, action_space: Any) -> DiscreteSpaces:
        """How observations and actions become indices.

        Raises:
            ValueError: they cannot.
        """
        return DiscreteSpaces(observation_space, action_space)

    @abc.abstractmethod
    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Improve the policy by a batch of episodes, and set the exploration."""

    @property
    @abc.abstractmethod
    def batch_episodes(self) -> int:
        """Episodes that one call of `learn` wants; the last of a budget may get fewer."""

    @abc.abstractmethod
    def sample(
        self, model: TabularModel, *, episodes: int, horizon: int, rng: np.random.Generator
    ) -> EpisodeBatch:
        """Sample whole episodes of a model by the behaviour policy, compiled."""

    @abc.abstractmethod
    def begin(self, seen: IntArray) -> list[FloatArray]:
        """Each agent's beliefs (n, Z) after the first observations (n, N)."""

    @abc.abstractmethod
    def advance(
        self, beliefs: Sequence[FloatArray], actions: IntArray, seen: IntArray
    ) -> list[FloatArray]:
        """Each agent's beliefs (n, Z) after actions (n, N) and the observations that followed."""

    @abc.abstractmethod
    def policy_probabilities(
        self, beliefs: Sequence[FloatArray], seen: IntArray
    ) -> list[FloatArray]:
        """Each agent's p(a | h), (n, A), by the learned policy; `seen` (n, N) came last."""

    def behaviour_probabilities(self) -> list[FloatArray]:
        """Each agent's p(a | h), (n, A), by the policy that explores, of the copies under way."""
        return self.policy_probabilities(self._belief, self._seen)

    def check_episodes(self, episodes: EpisodeBatch) -> None:
        """Check that episodes are of these agents and in their spaces; see `check_episodes`."""
        check_episodes(episodes, self.spaces.action_sizes, self.spaces.observation_sizes)

    def check_reward(self, smallest: float) -> None:
        """Check that the learner can use rewards down to this one; it can, unless overridden."""

    def train_in(self, env: Any, budget: Budget, seed: int) -> Iterator[Progress]:
        """Learn from whole episodes, compiled where the model is known; see `Agent.train_in`.

        Raises:
            ValueError: as there, or the model has rewards that the learner cannot use.
        """
        check_batch(env)
        model, horizon = getattr(env, "model", None), horizon_of(env)
        if not isinstance(model, TabularModel) or horizon is None:
            return super().train_in(env, budget, seed)
        self.check_model(model)
        return self._sampling(model, horizon, budget, np.random.default_rng(seed))

    def check_model(self, model: TabularModel) -> None:
        """Check that the learner can be trained on a model.

        Raises:
            ValueError: it cannot.
        """
        self.check_reward(smallest_reward(model))

    def _sampling(
        self, model: TabularModel, horizon: int, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Progress]:
        """Sample and learn, batch by batch; the last one keeps the episodes that still fit."""
        done, taken, earned, returned, spent = 0, 0, 0.0, 0.0, False
        while budget.allows(done, taken) and not spent:
            wanted = self.batch_episodes
            if budget.episodes is not None:
                wanted = min(wanted, budget.episodes - done)
            batch = self.sample(model, episodes=wanted, horizon=horizon, rng=rng)
            if budget.steps is not None and not budget.fits(taken + batch.n_steps):
                spent = True
                batch = batch.first(_fitting(batch, budget.steps - taken))
            if batch.n_episodes:
                done, taken = done + batch.n_episodes, taken + batch.n_steps
                earned += float(batch.rewards.sum())
                returned += float(batch.returns(self.discount).sum())
                yield Progress(done, taken, self.learn(batch), earned, returned / done)
        metrics = self.finish()
        if metrics or not done:
            yield Progress(done, taken, metrics, earned, returned / done if done else None)

    def reset(self, observation: Any, mask: BoolArray | None = None) -> None:
        """Begin new episodes; see `Agent.reset`. The number of copies may change if all begin."""
        seen = self.spaces.observations(observation)
        begun = np.ones(len(seen), dtype=np.bool_) if mask is None else np.asarray(mask, bool)
        if begun.shape != (len(seen),):
            raise ValueError(f"mask: shape {begun.shape}, must be ({len(seen)},)")
        first = self.begin(seen)
        if len(seen) != len(self._alive):
            if not begun.all():
                raise ValueError(f"{len(seen)} copies, was {len(self._alive)}: reset all of them")
            self._belief = [np.zeros_like(belief) for belief in first]
            self._seen, self._alive = seen.copy(), begun.copy()
        self._recorder.begin(begun)
        self._seen[begun] = seen[begun]
        self._alive |= begun
        for belief, fresh in zip(self._belief, first, strict=True):
            belief[begun] = fresh[begun]

    def act(self, observation: Any) -> Any:
        """Sample actions from the policy that explores; see `Agent.act`."""
        require_alive(self._alive)
        check_copies(len(self._alive), observation=self.spaces.observations(observation)[:, 0])
        chosen = np.stack([_sample(p, self.rng) for p in self.behaviour_probabilities()], axis=1)
        return self.spaces.external_actions(chosen, observation)

    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition with its behaviour probability; see `Agent.observe`."""
        require_alive(self._alive)
        actions, seen = self.spaces.actions(action), self.spaces.observations(observation)
        rewards = self.spaces.reward(reward)
        ended = self.spaces.flag("terminated", terminated)
        cut = self.spaces.flag("truncated", truncated)
        check_copies(
            len(self._alive),
            action=actions[:, 0],
            reward=rewards,
            observation=seen[:, 0],
            terminated=ended,
            truncated=cut,
        )
        self.check_reward(float(rewards.min()))
        copies = np.arange(len(actions))
        behaviour = np.stack(
            [p[copies, actions[:, n]] for n, p in enumerate(self.behaviour_probabilities())], axis=1
        )
        self._recorder.add(self._seen, actions, rewards, behaviour, seen, ended, cut)
        self._belief = self.advance(self._belief, actions, seen)
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
        """Act on the beliefs; see `Agent.predict`."""
        seen = self.spaces.observations(observation)
        beliefs = self._predicted_beliefs(seen, state, episode_start)
        chosen = np.stack(
            [
                p.argmax(axis=1) if deterministic else _sample(p, self.predict_rng)
                for p in self.policy_probabilities(beliefs, seen)
            ],
            axis=1,
        )
        kept = beliefs[0] if len(beliefs) == 1 else tuple(beliefs)
        return self.spaces.external_actions(chosen, observation), PolicyState(kept, chosen)

    def _predicted_beliefs(
        self, seen: IntArray, state: PolicyState | None, episode_start: Any
    ) -> list[FloatArray]:
        begun = self.begin(seen)
        if state is None:
            return begun
        fresh = np.zeros(len(seen), dtype=np.bool_)
        if episode_start is not None:
            fresh |= np.asarray(episode_start, dtype=np.bool_)
        check_copies(len(seen), state=state.action[:, 0])
        last = (state.belief,) if isinstance(state.belief, np.ndarray) else state.belief
        return [
            np.where(fresh[:, None], first, after)
            for first, after in zip(begun, self.advance(last, state.action, seen), strict=True)
        ]

    def state_arrays(self) -> Arrays:
        """Beliefs and what is recorded."""
        arrays: Arrays = {"seen": self._seen, "alive": self._alive}
        arrays |= {f"belief_{n}": belief for n, belief in enumerate(self._belief)}
        return arrays | self._recorder.state_arrays()

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        sizes = self.spaces.action_sizes, self.spaces.observation_sizes
        copies = len(arrays["alive"])
        self._alive = taken(arrays, "alive", (copies,)).astype(np.bool_)
        self._seen = taken(arrays, "seen", (copies, len(sizes[0]))).astype(np.int64)
        for n, size in enumerate(sizes[1]):
            check_range("seen", self._seen[:, n], size)
        self._recorder.restore(arrays, *sizes)
        if self._recorder.n_copies != copies:
            raise ValueError(f"recorder_length: of {self._recorder.n_copies} copies, not {copies}")
        self._belief = [
            _restored_belief(arrays, f"belief_{n}", first)
            for n, first in enumerate(self.begin(self._seen) if copies else [])
        ]


def _restored_belief(arrays: Arrays, name: str, like: FloatArray) -> FloatArray:
    """Beliefs (n, Z) of a policy file; (ValueError) of other shape or mass than others."""
    belief = taken(arrays, name, like.shape)
    if (belief < 0.0).any() or not np.allclose(belief.sum(axis=1), like.sum(axis=1)):
        raise ValueError(f"{name}: a row is no distribution")
    return belief


def _sample(probabilities: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw one index a row of (n, A)."""
    cumulative = np.cumsum(probabilities, axis=1)
    uniform = rng.random(len(cumulative))[:, None] * cumulative[:, -1:]
    index: IntArray = np.argmax(cumulative > uniform, axis=1)
    return index


def smallest_reward(model: TabularModel) -> float:
    """The smallest reward of any transition with any observation that is possible then."""
    action, _, end = model.support
    reward = model.support_reward
    if reward.shape[1] > 1:
        reward = reward[model.observation_rows[action * model.n_states + end].nonzero()]
    return float(reward.min())


def _fitting(batch: EpisodeBatch, steps: int) -> int:
    """How many of the first episodes have no more than so many steps together."""
    return int(np.searchsorted(batch.offsets, steps, side="right")) - 1
