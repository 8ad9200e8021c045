"""What every controller learner shares: acting, recording, exploring, saving."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bnprl_agents.agent import Agent, Metrics
from bnprl_agents.controllers.controller import Controller, normalised, random_controller
from bnprl_agents.controllers.exploration import exploring_probability, team_exploring
from bnprl_agents.controllers.messages import Counts, Messages
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.discrete import DiscreteSpaces
from bnprl_agents.episodes import BoolArray, EpisodeBatch, FloatArray, IntArray
from bnprl_agents.policy_files import Arrays
from bnprl_agents.recorder import EpisodeRecorder
from bnprl_envs.model import TabularModel


class PolicyState(NamedTuple):
    """What `predict` remembers of n copies.

    Attributes:
        belief: (n, Z) node distribution after the last observation, a tuple of them for a team.
        action: (n, N) last action indices.
    """

    belief: FloatArray | tuple[FloatArray, ...]
    action: IntArray


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


class ControllerAgent(Agent):
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
        self.spaces = DiscreteSpaces(observation_space, action_space)
        self.controllers = self.initial_controllers()
        self.explore = tuple(np.ones(c.n_nodes) for c in self.controllers)
        self._recorder = EpisodeRecorder(len(self.controllers))
        self._belief = [np.zeros((0, c.n_nodes)) for c in self.controllers]
        self._seen = np.zeros((0, len(self.controllers)), dtype=np.int64)
        self._alive = np.zeros(0, dtype=np.bool_)

    @abc.abstractmethod
    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Improve the controllers by a batch of episodes and set the exploration."""

    @property
    @abc.abstractmethod
    def batch_episodes(self) -> int:
        """Episodes that one call of `learn` wants; the last of a budget may get fewer."""

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

    def reset(self, observation: Any, mask: BoolArray | None = None) -> None:
        """Begin new episodes; see `Agent.reset`. The number of copies may change if all begin."""
        seen = self.spaces.observations(observation)
        begun = np.ones(len(seen), dtype=np.bool_) if mask is None else np.asarray(mask, bool)
        if begun.shape != (len(seen),):
            raise ValueError(f"mask: shape {begun.shape}, must be ({len(seen)},)")
        if len(seen) != len(self._alive):
            if not begun.all():
                raise ValueError(f"{len(seen)} copies, was {len(self._alive)}: reset all of them")
            self._belief = [np.zeros((len(seen), c.n_nodes)) for c in self.controllers]
            self._seen, self._alive = seen.copy(), begun.copy()
        self._recorder.begin(begun)
        self._seen[begun] = seen[begun]
        self._alive |= begun
        for n, controller in enumerate(self.controllers):
            self._belief[n][begun] = controller.begin(seen[begun, n])

    def act(self, observation: Any) -> Any:
        """Sample actions from the controllers mixed with exploration; see `Agent.act`."""
        self._require_alive()
        chosen = np.stack([_sample(p, self.rng) for p in self.behaviour_probabilities()], axis=1)
        return self.spaces.external_actions(chosen, observation)

    def behaviour_probabilities(self) -> list[FloatArray]:
        """For each agent (n, A): the controller mixed with uniform exploration, (2.46)."""
        probabilities = []
        for controller, belief, explore in zip(
            self.controllers, self._belief, self.explore, strict=True
        ):
            exploring = (belief @ explore)[:, None]
            exploit = controller.action_probabilities(belief)
            probabilities.append((1.0 - exploring) * exploit + exploring / controller.n_actions)
        return probabilities

    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition with its behaviour probability; see `Agent.observe`."""
        self._require_alive()
        actions, seen = self.spaces.actions(action), self.spaces.observations(observation)
        rewards = self.spaces.reward(reward)
        self.check_reward(float(rewards.min()))
        ended = self.spaces.flag("terminated", terminated)
        cut = self.spaces.flag("truncated", truncated)
        copies = np.arange(len(actions))
        behaviour = np.stack(
            [p[copies, actions[:, n]] for n, p in enumerate(self.behaviour_probabilities())], axis=1
        )
        self._recorder.add(self._seen, actions, rewards, behaviour, seen, ended, cut)
        for n, controller in enumerate(self.controllers):
            self._belief[n] = controller.advance(self._belief[n], actions[:, n], seen[:, n])
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
        """Act by the filtered controllers; see `Agent.predict`."""
        seen = self.spaces.observations(observation)
        beliefs = self._predicted_beliefs(seen, state, episode_start)
        actions = []
        for controller, belief in zip(self.controllers, beliefs, strict=True):
            p = controller.action_probabilities(belief)
            actions.append(p.argmax(axis=1) if deterministic else _sample(p, self.predict_rng))
        chosen = np.stack(actions, axis=1)
        kept = beliefs[0] if len(beliefs) == 1 else tuple(beliefs)
        return self.spaces.external_actions(chosen, observation), PolicyState(kept, chosen)

    def _predicted_beliefs(
        self, seen: IntArray, state: PolicyState | None, episode_start: Any
    ) -> list[FloatArray]:
        begun = [c.begin(seen[:, n]) for n, c in enumerate(self.controllers)]
        if state is None:
            return begun
        fresh = np.zeros(len(seen), dtype=np.bool_)
        if episode_start is not None:
            fresh |= np.asarray(episode_start, dtype=np.bool_)
        last = (state.belief,) if isinstance(state.belief, np.ndarray) else state.belief
        return [
            np.where(fresh[:, None], first, c.advance(belief, state.action[:, n], seen[:, n]))
            for n, (c, first, belief) in enumerate(zip(self.controllers, begun, last, strict=True))
        ]

    def set_exploration(self, occupancies: Sequence[FloatArray]) -> None:
        """Draw the nodes' exploration anew from their value-weighted occupancies (Z,)."""
        self.explore = tuple(
            exploring_probability(occupancy, self.config.exploration_prior, self.rng)
            for occupancy in occupancies
        )

    def exploring_share(self, messages: Sequence[Messages]) -> float:
        """Mean probability that the team explores at a step of the episodes just filtered."""
        each = [m.alpha @ explore for m, explore in zip(messages, self.explore, strict=True)]
        return float(team_exploring(np.stack(each, axis=1)).mean())

    def state_arrays(self) -> Arrays:
        """Controllers, exploration, beliefs and what is recorded."""
        arrays: Arrays = {"seen": self._seen, "alive": self._alive}
        for n, (controller, explore, belief) in enumerate(
            zip(self.controllers, self.explore, self._belief, strict=True)
        ):
            arrays |= {f"{name}_{n}": table for name, table in vars(controller).items()}
            arrays |= {f"explore_{n}": explore, f"belief_{n}": belief}
        return arrays | self._recorder.state_arrays()

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        team = range(len(self.controllers))
        self.controllers = tuple(
            Controller(*(arrays[f"{name}_{n}"] for name in Counts._fields)) for n in team
        )
        for n, controller in enumerate(self.controllers):
            wanted = (self.spaces.action_sizes[n], self.spaces.observation_sizes[n])
            if (controller.n_actions, controller.n_observations) != wanted:
                raise ValueError(f"controller {n} does not fit the spaces")
            for name in ("initial", "action", "successor"):
                if np.abs(getattr(controller, name).sum(axis=-1) - 1.0).max() > 1e-6:
                    raise ValueError(f"a row of {name}_{n} does not sum to 1")
        self.explore = tuple(arrays[f"explore_{n}"] for n in team)
        self._belief = [arrays[f"belief_{n}"] for n in team]
        self._seen, self._alive = arrays["seen"], arrays["alive"]
        self._recorder.restore(arrays)

    def _require_alive(self) -> None:
        if not self._alive.size or not self._alive.all():
            raise RuntimeError(
                "an episode has ended or none has begun: call reset(observation, mask) first"
            )


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


def _sample(probabilities: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw one index a row of (n, A)."""
    cumulative = np.cumsum(normalised(probabilities), axis=1)
    uniform = rng.random(len(cumulative))[:, None] * cumulative[:, -1:]
    index: IntArray = np.argmax(cumulative > uniform, axis=1)
    return index
