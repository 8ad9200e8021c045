"""The interface that every agent shares, and how agents are kept in files."""

from __future__ import annotations

import abc
import dataclasses
import importlib
import os
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from bnprl_agents.policy_files import (
    Arrays,
    build_space,
    describe_space,
    read_policy,
    refusing_damage,
    write_policy,
)
from bnprl_agents.training import Budget, Progress, check_batch, step_copies

Metrics = dict[str, float]

FORMAT = "bnprl-policy"
"""How an agent's policy file calls itself."""

AGENT_CLASSES = {
    "RandomAgent": "bnprl_agents.random_agent",
    "BatchEM": "bnprl_agents.controllers.em",
    "OnlineEM": "bnprl_agents.controllers.online_em",
    "MonteCarloEM": "bnprl_agents.controllers.mcem",
    "InfiniteRPR": "bnprl_agents.controllers.infinite",
    "StickBreaking": "bnprl_agents.controllers.stick_breaking",
    "VariationalBayes": "bnprl_agents.controllers.variational",
    "ActorCritic": "bnprl_agents.controllers.actor_critic",
    "PredictiveActorCritic": "bnprl_agents.belief.predictive_actor_critic",
    "ControllerSearch": "bnprl_agents.search.controller_search",
    "GPQ": "bnprl_agents.gaussian_process.gp_q",
    "GPFittedQ": "bnprl_agents.gaussian_process.gp_fitted_q",
    "TabularQ": "bnprl_agents.q_learning.tabular_q",
    "LinearQ": "bnprl_agents.q_learning.linear_q",
    "GQ": "bnprl_agents.q_learning.linear_q",
}
"""Class name in a policy file -> the module that defines it; nothing else is ever imported."""


class Agent(abc.ABC):
    """A learner with the shared interface: reset, act, observe, update, predict, save.

    Observations, actions and rewards carry a leading axis of environments (n_envs,); a scalar
    is a batch of one and comes back as a scalar. For many agents observations and actions are
    dicts from agent name to such values, as in PettingZoo's parallel environments, or arrays
    (n_envs, N) in the order of the spaces, as in this suite's batches; actions come back in the
    form of the observations.

    Args:
        observation_space: space of one environment's observation, or a dict of them for many
            agents.
        action_space: likewise.
        config: settings, an instance of `Config`; None means the defaults.
        discount: factor in (0, 1].
        seed: everything random in the agent is drawn from two generators spawned from it, one
            for learning and one for `predict`, so that evaluation never disturbs learning.

    Raises:
        ValueError: a space, setting or discount that the agent cannot use.
    """

    Config: ClassVar[type[Any]]
    preferred_copies: ClassVar[int] = 16
    """Copies of the environment to step together; 1 for learners that count their steps."""

    def __init__(
        self,
        observation_space: gym.Space[Any] | Mapping[str, gym.Space[Any]],
        action_space: gym.Space[Any] | Mapping[str, gym.Space[Any]],
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        if not 0.0 < discount <= 1.0:
            raise ValueError(f"discount: {discount}, must lie in (0, 1]")
        if config is not None and not isinstance(config, self.Config):
            raise ValueError(
                f"config: {type(config).__name__}, must be {self.Config.__name__} or None"
            )
        self.observation_space = observation_space
        self.action_space = action_space
        self.config = self.Config() if config is None else config
        self.discount = float(discount)
        learning, acting = np.random.SeedSequence(seed).spawn(2)
        self.rng = np.random.default_rng(learning)
        self.predict_rng = np.random.default_rng(acting)

    @abc.abstractmethod
    def reset(self, observation: Any, mask: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes with these first observations (only where `mask` is true)."""

    @abc.abstractmethod
    def act(self, observation: Any) -> Any:
        """Choose actions by the behaviour policy, which explores."""

    @abc.abstractmethod
    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition; `observation` is the true next one, also at an episode's end."""

    @abc.abstractmethod
    def update(self) -> Metrics:
        """Learn from what was observed since the last update; {} if there is nothing to do."""

    def finish(self) -> Metrics:
        """Learn from what `update` was still waiting to add to; {} if there is nothing."""
        return {}

    def train_in(self, env: Any, budget: Budget, seed: int) -> Iterator[Progress]:
        """Learn in an environment until the budget is spent, by stepping its copies.

        Learners that know a faster way to the same end override this; see
        `bnprl_agents.training.train`.

        Raises:
            ValueError: the environment will not do.
        """
        check_batch(env)
        return step_copies(self, env, budget, seed)

    def first_update_episodes(self, env: Any) -> int:
        """Return in how many whole episodes a first update surely fits: one in every copy."""
        return int(getattr(env, "num_envs", 1))

    @abc.abstractmethod
    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions by the learned policy, without exploration or learning.

        The signature is Stable-Baselines3's, so that its `evaluate_policy` runs unchanged.

        Args:
            observation: (n_envs,) observations, or a scalar.
            state: what the last call returned; None at the start.
            episode_start: (n_envs,) booleans: where true the state is begun anew.
            deterministic: take the most probable action instead of sampling. For a stochastic
                controller that is another policy than the one its exact value scores.

        Returns:
            The actions and the new state.
        """

    @abc.abstractmethod
    def state_arrays(self) -> Arrays:
        """Everything learned, as arrays."""

    @abc.abstractmethod
    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over what `state_arrays` and `counters` gave.

        Raises:
            ValueError: an array is missing or has the wrong shape.
        """

    def counters(self) -> dict[str, Any]:
        """Everything else that resuming needs, as JSON values."""
        return {}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the agent to a policy file, which appears by atomic rename."""
        meta = {
            "format": FORMAT,
            "version": 1,
            "agent": type(self).__name__,
            "config": dataclasses.asdict(self.config),
            "discount": self.discount,
            "observation_space": describe_space(self.observation_space),
            "action_space": describe_space(self.action_space),
            "counters": self.counters(),
            "rng": self.rng.bit_generator.state,
            "predict_rng": self.predict_rng.bit_generator.state,
        }
        write_policy(path, meta, self.state_arrays())


def load(path: str | os.PathLike[str], agent_class: type[Agent] | None = None) -> Agent:
    """Read an agent from a policy file; it goes on exactly where the saved one stood.

    Args:
        path: of the file.
        agent_class: of what was saved, where that is not one of this suite's agents.

    Raises:
        PolicyFileError: the file does not hold an agent's policy.
        OSError: the file cannot be read.
    """
    meta, arrays = read_policy(path)
    with refusing_damage(path):
        if (meta["format"], meta["version"]) != (FORMAT, 1):
            raise ValueError(f"format {meta['format']!r}, version {meta['version']!r}")
        cls = _class_of(meta["agent"], agent_class)
        agent = cls(
            build_space(meta["observation_space"]),
            build_space(meta["action_space"]),
            cls.Config(**meta["config"]),
            discount=meta["discount"],
            seed=0,
        )
        agent.restore(arrays, meta["counters"])
        agent.rng.bit_generator.state = meta["rng"]
        agent.predict_rng.bit_generator.state = meta["predict_rng"]
    return agent


def _class_of(name: str, own: type[Agent] | None) -> type[Agent]:
    """Return one of this suite's agents by name, or the class given if that is its name."""
    if own is not None and own.__name__ == name:
        return own
    if name not in AGENT_CLASSES:
        raise ValueError(f"unknown agent {name!r}; the class of an agent of your own must be given")
    found: type[Agent] = getattr(importlib.import_module(AGENT_CLASSES[name]), name)
    return found
