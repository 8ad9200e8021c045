"""The stick-breaking prior over controllers as an M-step; Definition 15."""

from __future__ import annotations

import numpy as np

from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.controllers.dirichlet import dirichlet_divergence, geometric_mean
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.controllers.priors import Posterior
from bnprl_agents.controllers.sticks import (
    Sticks,
    geometric_rows,
    mean_rows,
    stick_divergence,
    sticks_around,
    updated_sticks,
)
from bnprl_agents.episodes import FloatArray
from bnprl_agents.policy_files import Arrays

ITERATIONS = 5
"""Of the coordinate ascent on sticks and hyper-parameters within one M-step."""


class StickBreakingPrior:
    """Stick-breaking rows over nodes, Dirichlet rows over actions; Definition 15.

    Args:
        actions: (A,) Dirichlet parameters of every row over actions.
        shape: c of the Gamma hyper-prior of the sticks' second parameters.
        rate: d of it.
        row_evidence: rows with at most this count keep their posterior.
    """

    def __init__(self, actions: FloatArray, shape: float, rate: float, row_evidence: float) -> None:
        self.actions, self.shape, self.rate = actions, shape, rate
        self.row_evidence = row_evidence

    def around(self, controller: Controller) -> Posterior:
        """The controller's rows as from one visit of every entry, and the prior's actions."""
        sticks = [
            sticks_around(rows, controller.n_nodes, self.shape)
            for rows in (controller.initial, controller.successor)
        ]
        return self._posterior(self.actions + self.actions.size * controller.action, *sticks)

    def update(self, counts: Counts, old: Posterior) -> Posterior:
        """Return the posterior given counts; rows without evidence keep the old one's."""
        return self._posterior(
            self.actions + counts.action,
            *(
                self._updated(rows, self._sticks(old.parameters, name))
                for name, rows in (("initial", counts.initial), ("successor", counts.successor))
            ),
        )

    def restore(self, mean: Controller, parameters: Arrays) -> Posterior:
        """Build a saved posterior again."""
        sticks = [self._sticks(parameters, name) for name in ("initial", "successor")]
        return self._posterior(parameters["action"], *sticks)

    def unmet_divergence(self, posterior: Posterior) -> float:
        """KL of the rows that are as they began, which `sticks_around` gave their rate."""
        found = 0.0
        for name in ("initial", "successor"):
            sticks = self._sticks(posterior.parameters, name)
            unmet = (sticks.rate == self.shape + 1.0).all(axis=-1)
            kept = Sticks(*(part[unmet] for part in sticks))
            found += stick_divergence(kept, self.shape, self.rate)
        return found

    def _updated(self, counts: FloatArray, old: Sticks) -> Sticks:
        seen = counts.sum(axis=-1) > self.row_evidence
        fresh = Sticks(*(part.copy() for part in old))
        begun = Sticks(*(part[seen] for part in old))
        found = updated_sticks(counts[seen], begun, self.shape, self.rate, ITERATIONS)
        for whole, part in zip(fresh, found, strict=True):
            whole[seen] = part
        return fresh

    def _sticks(self, parameters: Arrays, name: str) -> Sticks:
        return Sticks(*(parameters[f"{name}_{part}"] for part in Sticks._fields))

    def _posterior(self, actions: FloatArray, initial: Sticks, successor: Sticks) -> Posterior:
        sticks = {"initial": initial, "successor": successor}
        prior = np.broadcast_to(self.actions, actions.shape)
        return Posterior(
            mean=Controller(mean_rows(initial), normalised(actions), mean_rows(successor)),
            geometric=Controller(
                geometric_rows(initial), geometric_mean(actions), geometric_rows(successor)
            ),
            divergence=dirichlet_divergence(actions, prior)
            + sum(stick_divergence(rows, self.shape, self.rate) for rows in sticks.values()),
            parameters={"action": actions}
            | {
                f"{name}_{part}": table
                for name, rows in sticks.items()
                for part, table in rows._asdict().items()
            },
        )
