"""Variational Bayes for controllers of fixed size: Theorems 10 and 14."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bnprl_agents.controllers.dirichlet import DirichletPrior
from bnprl_agents.controllers.nested_em import NestedEM, NestedEMConfig
from bnprl_agents.controllers.priors import Prior
from bnprl_agents.controllers.schedules import check_schedule, robbins_monro
from bnprl_agents.episodes import EpisodeBatch


@dataclass(frozen=True)
class BayesianConfig(NestedEMConfig):
    """Settings that the Bayesian learners have in common."""

    schedule: Literal["batch", "online"] = "online"
    """batch: the newest episodes alone are the evidence. online: running means of the statistics,
    which is stochastic variational inference (the dissertation's future work)."""
    rate_exponent: float = 0.6
    """kappa of the online learning rate alpha_n = (1 + n / rate_offset)^-kappa, in (0.5, 1]."""
    rate_offset: float = 10.0
    """Updates after which the online learning rate begins to fall."""
    evidence_scale: float = 0.0
    """Episodes as which the data weigh against the prior. 1: as printed, whatever their number,
    so that priors of size 1 dominate. 0: as many as there are, so that evidence accumulates."""
    action_prior: float = 1.0
    """Sum of the Dirichlet parameters rho of a node's actions, 1 / A each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_schedule(self.rate_exponent, self.rate_offset)
        if self.schedule not in ("batch", "online"):
            raise ValueError(f"schedule: {self.schedule!r}, must be 'batch' or 'online'")
        if not 0.0 <= self.evidence_scale < np.inf:
            raise ValueError(f"evidence_scale: {self.evidence_scale}, must not be negative")
        if not 0.0 < self.action_prior < np.inf:
            raise ValueError(f"action_prior: {self.action_prior}, must be positive")


class BayesianEM(NestedEM):
    """Nested variational Bayes; subclasses choose the prior."""

    config: BayesianConfig

    def learning_rate(self, episodes: EpisodeBatch) -> float:
        """alpha_n of the update under way; a batch of fewer episodes gets its share of it."""
        if self.config.schedule == "batch":
            return 1.0
        return self.batch_share(episodes) * robbins_monro(
            self.updates, self.config.rate_exponent, self.config.rate_offset
        )

    def evidence_episodes(self, episodes: EpisodeBatch) -> int:
        """The batch's episodes, or, online, all so far."""
        return episodes.n_episodes if self.config.schedule == "batch" else self.episodes

    def evidence_scale(self, episodes: EpisodeBatch) -> float:
        """Number of episodes as which the statistics weigh against the prior."""
        return self.config.evidence_scale or float(self.evidence_episodes(episodes))


@dataclass(frozen=True)
class VariationalBayesConfig(BayesianConfig):
    """Settings of `VariationalBayes`. The source leaves the priors, K and the iterations open."""

    node_prior: float = 1.0
    """Sum of the Dirichlet parameters of a row over nodes, 1 / Z each; below Z it is sparse."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.node_prior < np.inf:
            raise ValueError(f"node_prior: {self.node_prior}, must be positive")


class VariationalBayes(BayesianEM):
    """Posterior over controllers under Dirichlet priors; one controller for each agent.

    The E-step runs with exp(E ln theta), which is under-normalised; acting uses the posterior
    mean. Under the batch schedule the bound ln V(exp E ln theta) x scale - KL(posterior || prior)
    never falls on the same episodes.

    Paper: Li, Liao and Carin, Multi-task reinforcement learning in partially observable stochastic
    environments, JMLR 10, 2009; dissertation, Theorems 10 and 14.
    """

    Config = VariationalBayesConfig
    config: VariationalBayesConfig

    def make_priors(self) -> tuple[Prior, ...]:
        """Symmetric Dirichlet rows."""
        nodes = np.full(self.config.nodes, self.config.node_prior / self.config.nodes)
        return tuple(
            DirichletPrior(nodes, np.full(size, self.config.action_prior / size))
            for size in self.spaces.action_sizes
        )
