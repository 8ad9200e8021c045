"""DEC-SBPR: controllers whose size is inferred by stick-breaking priors, section 6.4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller, restored_exploration
from bnprl_agents.controllers.initialisation import (
    controllers_from_episodes,
    controllers_of_observations,
)
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.controllers.priors import (
    Posterior,
    evidence_arrays,
    node_count,
    restored_evidence,
)
from bnprl_agents.controllers.schedules import restored_log, saved_log
from bnprl_agents.controllers.stick_breaking_prior import StickBreakingPrior
from bnprl_agents.controllers.variational import BayesianConfig, BayesianEM
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays, number

LARGEST_UNMET = 1e15
"""Divergence of rows without evidence next to which a nat can still be told."""


@dataclass(frozen=True)
class StickBreakingConfig(BayesianConfig):
    """Settings of `StickBreaking`. The source leaves K, iterations and u1 open.

    The defaults weigh whole episodes by their returns, since a shift that makes the rewards of
    the decentralised benchmarks positive drowns the signal; weighting="reward" is Algorithm 5.

    Rows (a, o, i) without evidence keep the posterior that they have, in the beginning that of the
    initial controller: under the printed hyper-priors they would drift to the last node
    (shape-rate) or the first (shape-scale).
    """

    nodes: int = 10
    """Truncation level: nodes of every controller, of which the learner uses as many as pay."""
    schedule: Literal["batch", "online"] = "batch"
    """batch: Algorithm 5 on the newest episodes. online: running means of the statistics, which is
    stochastic variational inference (the dissertation's future work)."""
    batch_episodes: int = 300
    """Episodes collected under the current policy for one update, then discarded."""
    weighting: Literal["reward", "return", "linear"] = "return"
    """reward: every reward by its importance ratio, the empirical value (2.45). return: whole
    on-policy episodes by exp(temperature x standardised return), which needs no shift. linear: by
    max(0, 1 + temperature x standardised return), where luck must not pass for skill."""
    temperature: float = 4.0
    """Of the weightings by return; larger values look at the best episodes only, and decide sooner
    for less. 1 goes well with linear."""
    exploration_prior: float = 0.1
    """u1 of the Beta distribution from which a node's exploitation is drawn; larger explores."""
    hyper_shape: float = 0.1
    """c = e, shape of the Gamma hyper-priors of the sticks' second parameters."""
    hyper_second: float = 1e-6
    """d = f, the second parameter of the Gamma hyper-priors."""
    hyper_reading: Literal["rate", "scale"] = "rate"
    """What d = f is, which the source leaves open. rate: sticks without evidence pass on to the
    last node. scale: they keep everything at the first."""
    row_evidence: float = 1e-3
    """Rows over nodes with at most this count have no evidence."""
    initialisation: Literal["observations", "random", "episodes"] = "observations"
    """observations: every node begins as a last observation, with some random rows mixed in; ours.
    random: rows drawn at random. episodes: section 6.5, the merged history tree of the best random
    episodes, which are the first batch."""
    initial_episodes: int = 10
    """How many of the best episodes the initialisation keeps."""
    starts: int = 1
    """How often to begin anew; the start whose newest episodes earned most goes on, also where the
    budget ends before the last start does. Ours."""
    start_updates: int = 20
    """Updates of each start where there are several."""
    node_share: float = 0.01
    """A node is in use where its part of the reward-weighted visits exceeds this; (6.16)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("hyper_shape", "hyper_second"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name}: {getattr(self, name)}, must be positive")
        if self.hyper_reading not in ("rate", "scale"):
            raise ValueError(f"hyper_reading: {self.hyper_reading!r}, must be 'rate' or 'scale'")
        if self.initialisation not in ("observations", "random", "episodes"):
            raise ValueError(
                f"initialisation: {self.initialisation!r}, must be 'observations', 'random' or "
                "'episodes'"
            )
        for name in ("initial_episodes", "starts", "start_updates"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: {getattr(self, name)}, must be at least 1")
        if self.starts > 1 and self.schedule == "online":
            raise ValueError(f"starts: {self.starts}, must be 1 with the online schedule")
        if not self.row_evidence >= 0.0:
            raise ValueError(f"row_evidence: {self.row_evidence}, must not be negative")
        if not 0.0 <= self.node_share < 1.0:
            raise ValueError(f"node_share: {self.node_share}, must lie in [0, 1)")


class Start(NamedTuple):
    """What one start came to.

    Attributes:
        earned: running mean of its batches' mean returns, the newest counting half.
        log_value: ln V.
        explore: for each agent (Z,), the nodes' exploration.
        posteriors: one for each agent.
        statistics: one for each agent.
    """

    earned: float
    log_value: float
    explore: tuple[FloatArray, ...]
    posteriors: tuple[Posterior, ...]
    statistics: tuple[Counts, ...]


class StickBreaking(BayesianEM):
    """Decentralised stick-breaking policies: the number of nodes in use is inferred.

    Algorithm 5 with its misprints corrected; with the online schedule, stochastic variational
    inference on the same posterior. Under the batch schedule the bound ln V(exp E ln theta) x
    scale - KL(posterior || prior), hyper-parameters included, never falls on the same episodes.
    With several starts it may, where one ends.

    Attributes:
        earned: running mean of what this start's batches earned, the newest counting half.
        best: the best start so far, until the last one has ended.

    Paper: Liu, Amato, Liao, Carin and How, Stick-breaking policy learning in Dec-POMDPs, IJCAI
    2015; dissertation, section 6.4.
    """

    Config = StickBreakingConfig
    config: StickBreakingConfig
    priors: tuple[StickBreakingPrior, ...]
    earned: float = 0.0
    best: Start | None = None

    def initial_controllers(self) -> tuple[Controller, ...]:
        """Random controllers, or with nodes that begin as last observations."""
        drawn = super().initial_controllers()
        if self.config.initialisation == "observations":
            return controllers_of_observations(drawn)
        return drawn

    def make_priors(self) -> tuple[StickBreakingPrior, ...]:
        """The same hyper-priors for every agent."""
        config = self.config
        second = config.hyper_second
        rate = second if config.hyper_reading == "rate" else 1.0 / second
        return tuple(
            StickBreakingPrior(
                np.full(size, config.action_prior / size),
                config.hyper_shape,
                rate,
                config.row_evidence,
            )
            for size in self.spaces.action_sizes
        )

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Learn from a batch; see `NestedEM.learn`.

        Also returns the agents' mean node count and `bound_met`, the lower bound without the
        divergence of rows that never had evidence: they begin far from the prior, and would drown
        the rest. It is left out where rounding would drown it (`LARGEST_UNMET`).
        """
        starting, update = divmod(self.updates, self.config.start_updates)
        first = update == 0 and starting < self.config.starts
        if first and self.config.initialisation == "episodes":
            self.begin_at(
                controllers_from_episodes(
                    episodes, self.controllers, self.discount, self.config.initial_episodes
                )
            )
        unmet = sum(
            prior.unmet_divergence(posterior)
            for prior, posterior in zip(self.priors, self.posteriors, strict=True)
        )
        metrics = super().learn(episodes)
        if "bound" in metrics and unmet < LARGEST_UNMET:
            metrics["bound_met"] = metrics["bound"] + unmet
        used = [node_count(counts, self.config.node_share) for counts in self.statistics]
        earned = metrics["return_mean"]
        self.earned = earned if first else 0.5 * (self.earned + earned)
        if starting < self.config.starts and update == self.config.start_updates - 1:
            self._end_start(last=starting == self.config.starts - 1)
        return metrics | {"nodes": float(np.mean(used))}

    def _end_start(self, *, last: bool) -> None:
        """Keep the best start, and begin anew or, after the last one, go on with the best."""
        if self.best is None or self.earned > self.best.earned:
            evidence = (self.posteriors, self.statistics)
            self.best = Start(self.earned, self.log_value, self.explore, *evidence)
        if last:
            self._go_on_with(self.best)
            self.best = None
        else:
            self.begin_anew(self.initial_controllers())

    def _go_on_with(self, start: Start) -> None:
        self.adopt(start.posteriors)
        self.statistics, self.explore = start.statistics, start.explore
        self.log_value, self.earned = start.log_value, start.earned

    def finish(self) -> Metrics:
        """Learn as all do; then go on with the best start, unless the one under way earns more."""
        metrics = super().finish()
        under_way = self.updates % self.config.start_updates > 0
        if self.best is not None and not (under_way and self.earned > self.best.earned):
            self._go_on_with(self.best)
        return metrics

    def state_arrays(self) -> Arrays:
        """The learner's state and the best start so far."""
        arrays, best = super().state_arrays(), self.best
        if best is not None:
            arrays |= evidence_arrays(best.posteriors, best.statistics, "best_")
            arrays |= {f"best_explore_{n}": explore for n, explore in enumerate(best.explore)}
        return arrays

    def counters(self) -> dict[str, Any]:
        """What `NestedEM.counters` counts, and what the starts have earned."""
        best = None
        if self.best is not None:
            best = [self.best.earned, saved_log(self.best.log_value)]
        return super().counters() | {"earned": self.earned, "best": best}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.earned = number("earned", counters["earned"])
        if counters["best"] is not None:
            earned, log_value = counters["best"]
            explore = tuple(
                restored_exploration(arrays, f"best_explore_{n}", c.n_nodes)
                for n, c in enumerate(self.controllers)
            )
            evidence = restored_evidence(arrays, self.priors, self.controllers, "best_")
            self.best = Start(number("best", earned), restored_log(log_value), explore, *evidence)
