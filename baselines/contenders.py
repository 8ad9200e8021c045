"""Every learner by name, ours and Stable-Baselines3's, with its default settings as data.

A new learner is one entry of `CONTENDERS`.
"""

from __future__ import annotations

import difflib
import importlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from baselines import own

EXTRA_MODULES = ("stable_baselines3", "sb3_contrib", "torch")
"""What the extra `baselines` installs."""


class MissingExtraError(ImportError):
    """A contender needs an optional dependency; the message says how to install it."""


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
        return resolve(self.defaults)()


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
            "GPQ that is greedy on mean plus two variances",
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


def resolve(target: str) -> Any:
    """Import what "module:name" stands for.

    Raises:
        MissingExtraError: it needs an optional dependency that is not installed.
    """
    module, name = target.split(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in EXTRA_MODULES:
            raise
        raise MissingExtraError(
            f'{error.name} is not installed: pip install "bnprl[baselines]"'
        ) from error
