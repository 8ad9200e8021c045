"""Contenders at work: ours and Stable-Baselines3's behind one protocol."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from baselines import own
from baselines.contenders import Contender, resolve
from baselines.environment import EnvironmentSpec
from baselines.evaluation import Policy
from bnprl_agents.agent import Agent, load
from bnprl_agents.policy_files import read_policy
from bnprl_agents.training import Progress, train
from bnprl_envs.team import agent_spaces


class Learner(Protocol):
    """A contender at work in one environment."""

    policy_suffix: str
    """How the name of its policy file ends."""

    @property
    def policy(self) -> Policy:
        """The current policy; valid between two steps of `learn`."""

    def learn(self, *, episodes: int | None = None, steps: int | None = None) -> Iterator[Progress]:
        """Learn until the budget (one of the two, a total) is spent; may be called once."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the learned policy to a file that `load_policy` reads."""


class AgentLearner:
    """One of this suite's agents as a contender.

    Args:
        agent_class: the agent.
        environment: what to learn in.
        settings: the agent's config.
        seed: of everything random.
        n_envs: copies that are stepped together, None: as many as the agent prefers; the compiled
            rollout makes none.

    Attributes:
        agent: the learner, which is its own policy.

    Raises:
        ValueError: the agent cannot serve the environment, or as `EnvironmentSpec.make_vec`.
    """

    policy_suffix = ".npz"

    def __init__(
        self,
        agent_class: type[Agent],
        environment: EnvironmentSpec,
        settings: Any,
        seed: int,
        n_envs: int | None = None,
    ) -> None:
        agent_seed, env_seed = np.random.SeedSequence(seed).generate_state(2)
        self._env = environment.make_vec(n_envs or agent_class.preferred_copies, "Disabled")
        self._env_seed = int(env_seed)
        try:
            self.agent = agent_class(
                *agent_spaces(self._env),
                settings,
                discount=environment.discount,
                seed=int(agent_seed),
            )
        except ValueError as error:
            raise ValueError(f"{environment.id}: {error}") from error

    @property
    def policy(self) -> Agent:
        """The agent, whose `predict` is the learned policy."""
        return self.agent

    def learn(self, *, episodes: int | None = None, steps: int | None = None) -> Iterator[Progress]:
        """Learn until the budget is spent; see `bnprl_agents.training.train`.

        Raises:
            ValueError: the budget is not given by exactly one positive number.
        """
        return train(self.agent, self._env, seed=self._env_seed, episodes=episodes, steps=steps)

    def first_update_episodes(self) -> int:
        """Return in how many whole episodes a first update surely fits."""
        return self.agent.first_update_episodes(self._env)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the agent to a policy file, from which it could go on learning."""
        self.agent.save(path)


def build_learner(
    contender: Contender,
    environment: EnvironmentSpec,
    settings: Any | None,
    seed: int,
    tensorboard: Path | None = None,
) -> Learner:
    """Build a contender for an environment.

    Args:
        contender: which.
        environment: what it will learn in.
        settings: of the type of `contender.settings`; None: those.
        seed: of everything random, at least 0.
        tensorboard: folder for the log that Stable-Baselines3's learners write; the others'
            metrics are in the progress that `learn` yields.

    Raises:
        ValueError: it cannot serve the environment, or the settings are another learner's.
        MissingExtraError: a dependency is not installed.
    """
    chosen = contender.settings if settings is None else settings
    if type(chosen) is not type(contender.settings):
        raise ValueError(
            f"settings: {type(chosen).__name__}, but {contender.name} has "
            f"{type(contender.settings).__name__}"
        )
    if contender.family == "own":
        return AgentLearner(own.agent_class(contender.build), environment, chosen, seed)
    target = resolve(contender.build)
    if contender.family == "bnprl":
        return AgentLearner(target, environment, chosen, seed)
    learner: Learner = target(environment, chosen, seed, tensorboard)
    return learner


def load_policy(path: str | os.PathLike[str], agent: str | None = None) -> Policy:
    """Read the policy file of any contender.

    Args:
        path: of the file.
        agent: "module:class" that saved it, if it is the user's own.

    Raises:
        ValueError: there is no such class.
        PolicyFileError: the file does not hold a policy.
        MissingExtraError: a dependency is not installed.
        OSError: the file cannot be read.
    """
    meta, _ = read_policy(path)
    if meta.get("format") == "bnprl-sb3-policy":
        policy: Policy = resolve("baselines.sb3:load_sb3_policy")(path)
        return policy
    return load(path, None if agent is None else own.agent_class(agent))
