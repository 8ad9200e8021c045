"""Every learner by name, ours and Stable-Baselines3's, with its default settings as data.

A new learner is one entry of `CONTENDERS`.
"""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from baselines import own
from baselines.environment import EnvironmentSpec
from baselines.evaluation import Policy
from bnprl_agents.agent import Agent, load
from bnprl_agents.policy_files import read_policy
from bnprl_agents.training import Progress, train
from bnprl_envs.team import agent_spaces

EXTRA_MODULES = ("stable_baselines3", "sb3_contrib", "torch")
"""What the extra `baselines` installs."""


class MissingExtraError(ImportError):
    """A contender needs an optional dependency; the message says how to install it."""


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


@dataclass(frozen=True)
class Contender:
    """One learner that can be compared.

    Attributes:
        name: on the command line.
        summary: one line for listings.
        family: whose it is; "own" is the user's.
        defaults: "module:class" of its settings, imported when first used; of an own agent its
            `Config`.
        build: "module:class" of a subclass of `Agent`, or, for family "sb3", of a `Learner`
            whose constructor takes (environment, settings, seed, tensorboard).
    """

    name: str
    summary: str
    family: Literal["bnprl", "sb3", "own"]
    defaults: str
    build: str

    @cached_property
    def settings(self) -> Any:
        """The default settings: an instance of a frozen dataclass."""
        if self.family == "own":
            return own.agent_class(self.build).Config()
        return _resolve(self.defaults)()


def _agent(name: str, agent: str, config: str, summary: str) -> Contender:
    module = agent.split(":")[0]
    return Contender(name, summary, "bnprl", f"{module}:{config}", agent)


def _sb3(
    name: str, settings: str, summary: str, build: str = "baselines.sb3:SB3Learner"
) -> Contender:
    return Contender(name, summary, "sb3", f"baselines.sb3_settings:{settings}", build)


CONTENDERS: dict[str, Contender] = {
    contender.name: contender
    for contender in (
        _agent(
            "online-em",
            "bnprl_agents.controllers.online_em:OnlineEM",
            "OnlineEMConfig",
            "finite-state controllers by EM with running statistics",
        ),
        _agent(
            "batch-em",
            "bnprl_agents.controllers.em:BatchEM",
            "BatchEMConfig",
            "finite-state controllers by EM on batches of episodes",
        ),
        _agent(
            "actor-critic",
            "bnprl_agents.controllers.actor_critic:ActorCritic",
            "ActorCriticConfig",
            "finite-state controllers by policy gradient with a critic on the node belief",
        ),
        _agent(
            "predictive-actor-critic",
            "bnprl_agents.belief.predictive_actor_critic:PredictiveActorCritic",
            "PredictiveActorCriticConfig",
            "policies on the belief of a hidden Markov model, learned together",
        ),
        _agent(
            "controller-search",
            "bnprl_agents.search.controller_search:ControllerSearch",
            "ControllerSearchConfig",
            "local search over deterministic controllers, scored by simulated episodes",
        ),
        _agent(
            "variational",
            "bnprl_agents.controllers.variational:VariationalBayes",
            "VariationalBayesConfig",
            "finite-state controllers by variational Bayes with Dirichlet priors",
        ),
        _agent(
            "stick-breaking",
            "bnprl_agents.controllers.stick_breaking:StickBreaking",
            "StickBreakingConfig",
            "finite-state controllers whose size is inferred by stick-breaking priors (DEC-SBPR)",
        ),
        _agent(
            "infinite-rpr",
            "bnprl_agents.controllers.infinite:InfiniteRPR",
            "InfiniteRPRConfig",
            "finite-state controllers whose nodes are born and dropped under an HDP (iRPR)",
        ),
        _agent(
            "mcem",
            "bnprl_agents.controllers.mcem:MonteCarloEM",
            "MonteCarloEMConfig",
            "finite-state controllers by Monte-Carlo EM on sampled nodes",
        ),
        _agent(
            "gpq",
            "bnprl_agents.gaussian_process.gp_q:GPQ",
            "GPQConfig",
            "Q-learning with sparse online Gaussian processes, epsilon-greedy",
        ),
        _agent(
            "gpq-optimistic",
            "bnprl_agents.gaussian_process.gp_q:GPQ",
            "OptimisticGPQConfig",
            "the same, greedy on mean plus two variances",
        ),
        _agent(
            "gp-fitted-q",
            "bnprl_agents.gaussian_process.gp_fitted_q:GPFittedQ",
            "GPFittedQConfig",
            "fitted Q-iteration with exact Gaussian processes on batches",
        ),
        _agent(
            "tabular-q",
            "bnprl_agents.q_learning.tabular_q:TabularQ",
            "TabularQConfig",
            "Q-learning on a table of the quantised state",
        ),
        _agent(
            "linear-q",
            "bnprl_agents.q_learning.linear_q:LinearQ",
            "LinearQConfig",
            "Q-learning on fixed radial bases",
        ),
        _agent(
            "gq",
            "bnprl_agents.q_learning.linear_q:GQ",
            "GQConfig",
            "Q-learning on fixed radial bases with gradient correction",
        ),
        _agent(
            "random",
            "bnprl_agents.random_agent:RandomAgent",
            "RandomConfig",
            "uniformly random actions; learns nothing",
        ),
        _sb3("dqn", "DQNSettings", "deep Q-network on a stack of observations"),
        _sb3("ppo", "PPOSettings", "proximal policy optimisation on a stack of observations"),
        _sb3("a2c", "A2CSettings", "advantage actor-critic on a stack of observations"),
        _sb3("recurrent-ppo", "RecurrentPPOSettings", "proximal policy optimisation with an LSTM"),
        _sb3("ppo-shared", "SharedPPOSettings", "ppo of a team: one network for all agents"),
        _sb3(
            "ppo-independent",
            "IndependentPPOSettings",
            "ppo of a team: one network an agent",
            "baselines.sb3_independent:IndependentPPO",
        ),
        _sb3(
            "recurrent-ppo-shared",
            "SharedRecurrentPPOSettings",
            "recurrent-ppo of a team: one network for all agents",
        ),
    )
}
"""Name -> contender, in the order of listings."""


def contender(name: str) -> Contender:
    """Return the contender of a name; of "module:class" the user's own, which nothing imports yet.

    Raises:
        ValueError: there is none; near misses are named.
    """
    if name in CONTENDERS:
        return CONTENDERS[name]
    if own.is_own(name):
        return Contender(name, f"an agent of {name.partition(':')[0]}", "own", "", name)
    near = difflib.get_close_matches(name.lower(), CONTENDERS, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(CONTENDERS)}"
    raise ValueError(f"unknown agent {name!r}; {hint}")


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
    target = _resolve(contender.build)
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
        policy: Policy = _resolve("baselines.sb3:load_sb3_policy")(path)
        return policy
    return load(path, None if agent is None else own.agent_class(agent))


def _resolve(target: str) -> Any:
    module, name = target.split(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in EXTRA_MODULES:
            raise
        raise MissingExtraError(
            f'{error.name} is not installed: pip install "bnprl[baselines]"'
        ) from error
