"""Dirichlet priors over a controller's rows: Theorems 10 and 14."""

from __future__ import annotations

import numpy as np
from scipy.special import digamma, gammaln

from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.controllers.priors import Posterior
from bnprl_agents.episodes import FloatArray
from bnprl_agents.policy_files import Arrays


def geometric_mean(parameters: FloatArray) -> FloatArray:
    """exp(E ln theta) = exp(psi(a_i) - psi(sum a)) of Dirichlet rows; sums to less than 1."""
    mean: FloatArray = np.exp(digamma(parameters) - digamma(parameters.sum(axis=-1, keepdims=True)))
    return mean


def dirichlet_divergence(q: FloatArray, p: FloatArray) -> float:
    """KL(Dir(q) || Dir(p)), summed over rows."""
    total_q, total_p = q.sum(axis=-1, keepdims=True), p.sum(axis=-1, keepdims=True)
    entropy = np.sum((q - p) * (digamma(q) - digamma(total_q)), axis=-1)
    volumes = (gammaln(p) - gammaln(q)).sum(axis=-1) + (gammaln(total_q) - gammaln(total_p))[..., 0]
    return float(np.sum(volumes + entropy))


def one_visit(controller: Controller) -> Counts:
    """Counts as from one visit of every entry, shared out as the controller's rows are."""
    return Counts(
        controller.n_nodes * controller.initial,
        controller.n_actions * controller.action,
        controller.n_nodes * controller.successor,
    )


class DirichletPrior:
    """Independent Dirichlet rows, (5.3) and (6.4); the posterior is prior + counts, (6.7).

    Args:
        nodes: (Z,) parameters of every row over nodes.
        actions: (A,) parameters of every row over actions.
    """

    def __init__(self, nodes: FloatArray, actions: FloatArray) -> None:
        self.nodes, self.actions = nodes, actions

    def around(self, controller: Controller) -> Posterior:
        """Prior parameters plus the controller's rows, as from one visit of every entry."""
        return self.update(one_visit(controller), None)

    def update(self, counts: Counts, old: Posterior | None) -> Posterior:
        """Return prior + counts; a row without evidence is its prior."""
        return self._posterior(
            Counts(
                counts.initial + self.nodes,
                counts.action + self.actions,
                counts.successor + self.nodes,
            )
        )

    def restore(self, mean: Controller, parameters: Arrays) -> Posterior:
        """Build a saved posterior again."""
        return self._posterior(Counts(*(parameters[name] for name in Counts._fields)))

    def _posterior(self, parameters: Counts) -> Posterior:
        priors = (self.nodes, self.actions, self.nodes)
        return Posterior(
            mean=Controller(*(normalised(table) for table in parameters)),
            geometric=Controller(*(geometric_mean(table) for table in parameters)),
            divergence=sum(
                dirichlet_divergence(table, np.broadcast_to(prior, table.shape))
                for table, prior in zip(parameters, priors, strict=True)
            ),
            parameters=dict(parameters._asdict()),
        )
