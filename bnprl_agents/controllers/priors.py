"""M-steps: what evidence makes of a controller, by prior.

Every learner alternates one E-step (messages.py) with one of these. A prior turns node counts
into a posterior over controllers; the posterior offers two controllers, one to act with and one,
under-normalised in general, to run the E-step with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.episodes import FloatArray
from bnprl_agents.policy_files import Arrays, taken


@dataclass(frozen=True, eq=False)
class Posterior:
    """A distribution q over one agent's controllers.

    Attributes:
        mean: E[theta], the policy that acts.
        geometric: exp(E ln theta), what the E-step runs with; rows sum to at most 1.
        divergence: KL(q || prior), of the parameters and of what lies over them.
        parameters: arrays from which the prior builds the same posterior again.
    """

    mean: Controller
    geometric: Controller
    divergence: float = 0.0
    parameters: Arrays = field(default_factory=dict)


class Prior(Protocol):
    """An M-step."""

    def around(self, controller: Controller) -> Posterior:
        """Return a posterior whose mean is near a controller, to begin with."""

    def update(self, counts: Counts, old: Posterior) -> Posterior:
        """Return the posterior given node counts; `old` serves rows that have none."""

    def restore(self, mean: Controller, parameters: Arrays) -> Posterior:
        """Build a saved posterior again.

        Raises:
            KeyError: an array is missing.
        """


class MaximumLikelihood:
    """No prior: EM's M-step (4.8)."""

    def around(self, controller: Controller) -> Posterior:
        """Return the controller itself."""
        return Posterior(controller, controller)

    def update(self, counts: Counts, old: Posterior) -> Posterior:
        """Return the normalised counts."""
        return self.around(maximise(counts, old.mean))

    def restore(self, mean: Controller, parameters: Arrays) -> Posterior:
        """Return the controller itself."""
        return self.around(mean)


def maximise(counts: Counts, controller: Controller) -> Controller:
    """M-step (4.8): normalised counts; a row without evidence keeps its old distribution."""

    def rows(count: FloatArray, old: FloatArray) -> FloatArray:
        total = count.sum(axis=-1, keepdims=True)
        seen = total > 0.0
        return np.where(seen, count / np.where(seen, total, 1.0), old)

    return Controller(
        initial=rows(counts.initial, controller.initial),
        action=rows(counts.action, controller.action),
        successor=rows(counts.successor, controller.successor),
    )


def scaled(counts: Counts, factor: float) -> Counts:
    """Counts times a factor."""
    return Counts(*(factor * table for table in counts))


def blend(old: Counts, new: Counts, rate: float) -> Counts:
    """S <- (1 - alpha) s + alpha s_n; (4.15)."""
    return Counts(*((1.0 - rate) * s + rate * n for s, n in zip(old, new, strict=True)))


def node_count(counts: Counts, share: float) -> int:
    """Nodes in use, (6.16): those to which reward was assigned.

    Soft counts are never exactly 0, so a node counts where its part of all action counts
    exceeds `share`.
    """
    occupancy = counts.action.sum(axis=1)
    return int(np.count_nonzero(occupancy > share * occupancy.sum()))


def evidence_arrays(
    posteriors: Sequence[Posterior], statistics: Sequence[Counts], prefix: str = ""
) -> Arrays:
    """What a team has learned, as named arrays; the names begin with the prefix."""
    arrays: Arrays = {}
    for n, (posterior, counts) in enumerate(zip(posteriors, statistics, strict=True)):
        arrays |= {f"{prefix}posterior_{name}_{n}": p for name, p in posterior.parameters.items()}
        arrays |= {f"{prefix}statistics_{name}_{n}": s for name, s in counts._asdict().items()}
    return arrays


def restored_evidence(
    arrays: Arrays, priors: Sequence[Prior], means: Sequence[Controller], prefix: str = ""
) -> tuple[tuple[Posterior, ...], tuple[Counts, ...]]:
    """Posteriors and statistics from what `evidence_arrays` made of them.

    Raises:
        KeyError: an array is missing.
        ValueError: one does not fit the controllers.
    """
    posteriors, statistics = [], []
    for n, (prior, mean) in enumerate(zip(priors, means, strict=True)):
        begin, end = f"{prefix}posterior_", f"_{n}"
        parameters = {
            name.removeprefix(begin).removesuffix(end): table
            for name, table in arrays.items()
            if name.startswith(begin) and name.endswith(end)
        }
        posterior = prior.restore(mean, parameters)
        if posterior.mean.successor.shape != mean.successor.shape:
            raise ValueError(f"{begin}successor{end}: does not fit the controller")
        posteriors.append(posterior)
        statistics.append(restored_counts(arrays, f"{prefix}statistics_{{}}_{n}", mean))
    return tuple(posteriors), tuple(statistics)


def restored_counts(arrays: Arrays, names: str, like: Controller) -> Counts:
    """Counts of a controller's shapes, from arrays in whose names {} stands for the field.

    Raises:
        ValueError: one has another shape.
    """
    shapes = {name: table.shape for name, table in vars(like).items()}
    return Counts(*(taken(arrays, names.format(k), shapes[k]) for k in Counts._fields))
