"""The infinite regionalized policy representation (iRPR), chapter 5: nodes are born and dropped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.episode_pool import Behaviour, EpisodePool
from bnprl_agents.controllers.hierarchy import (
    HierarchicalPrior,
    embedded,
    first_hierarchy,
    only,
    resampled,
    restored_hierarchy,
    restricted,
    shared_out,
)
from bnprl_agents.controllers.infinite_settings import InfiniteRPRConfig
from bnprl_agents.controllers.messages import Counts, Messages, backward, forward
from bnprl_agents.controllers.paths import path_counts, reward_steps, sample_paths
from bnprl_agents.controllers.priors import Posterior, Prior, blend, restored_counts, scaled
from bnprl_agents.controllers.schedules import blended_value
from bnprl_agents.controllers.variational import BayesianEM
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays

T = TypeVar("T")
TINY = float(np.finfo(np.float64).tiny)


class Update(NamedTuple):
    """What the steps of one update have in common.

    Attributes:
        data: the episodes under study.
        statistics, sampled: soft and drawn counts before the update.
        log_value: ln V before it.
        rate: learning rate.
        scale: observations as which the statistics weigh against the prior.
    """

    data: EpisodeBatch
    statistics: tuple[Counts, ...]
    sampled: tuple[Counts, ...]
    log_value: float
    rate: float
    scale: float


class Fit(NamedTuple):
    """A posterior of one agent after some sweeps, its statistics, its bound and ln V."""

    posterior: Posterior
    statistics: Counts
    bound: float
    log_value: float


class InfiniteRPR(BayesianEM):
    """Controllers under a hierarchical Dirichlet process, by a hybrid Gibbs-variational sampler.

    A sweep takes nu and the nodes' posterior from the variational E-step, draws occupancies from
    it, and given these the nodes in use, the table counts m, beta, alpha and lambda. Nodes that
    hold nothing go back to the special state; where that is occupied a node is born. After the
    sweeps some nodes are divided on trial, and stay so where the lower bound rises. The special
    state and all nodes without reward always explore (unseen histories); the others as long as
    they were rewarded little against u1 (seen histories).

    Paper: Liu, Liao and Carin, The infinite regionalized policy representation, ICML 2011;
    dissertation, sections 5.2 and 5.3.
    """

    Config = InfiniteRPRConfig
    config: InfiniteRPRConfig
    priors: tuple[HierarchicalPrior, ...]
    preferred_copies = 1
    """Of several copies some would be under way when the policy changes, and the pool could not
    weigh their episodes against its mixture."""

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
        self.sampled = self.statistics
        self.pool = EpisodePool()

    def make_priors(self) -> tuple[Prior, ...]:
        """The same hierarchy for every agent."""
        first = first_hierarchy(self.config.nodes, self.config.initial_nodes)
        return tuple(
            HierarchicalPrior(np.full(size, self.config.action_prior / size), first)
            for size in self.spaces.action_sizes
        )

    def evidence_episodes(self, episodes: EpisodeBatch) -> int:
        """All episodes so far."""
        return self.episodes

    def evidence_scale(self, episodes: EpisodeBatch) -> float:
        """Observations as which the statistics weigh against the prior."""
        sharpened = self.episodes / (self.episodes + self.config.sharpening_episodes)
        each = self.config.evidence_per_episode * sharpened
        return self.config.evidence_scale or each * self.episodes

    def occupancies(self, data: EpisodeBatch) -> list[FloatArray]:
        """Return u0 (Z,): rewards, in units of the mean return, shared out by the visits.

        The sentence after (2.47), a reward is allocated "in proportion to" the visits before it;
        the sum as printed counts it for each of them.
        """
        visits = [counts.action.sum(axis=1) for counts in self.statistics]
        return [self.episodes * each / max(each.sum(), TINY) for each in visits]

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Learn from new episodes; see `NestedEM.learn`. Also returns the mean number of nodes."""
        metrics = super().learn(episodes)
        used = [int(prior.hierarchy.occupied.sum()) for prior in self.priors]
        return metrics | {"nodes": float(np.mean(used))}

    def improve(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Metrics:
        """Sweep over all episodes so far, or online over the newest, and try divisions."""
        rate, scale = self.learning_rate(data), self.evidence_scale(data)
        if self.config.schedule == "batch":
            data = self.pool.add(data, self._behaviour(data.n_episodes))
        update = Update(data, self.statistics, self.sampled, self.log_value, rate, scale)
        for _ in range(self.config.outer_iterations):
            if not self._sweep(update):
                self.log_value += np.log1p(-rate) if rate < 1.0 else 0.0
                return {"unchanged": 1.0}
        divided = [self._try_division(update) for _ in range(self.config.divisions)]
        return {"learning_rate": rate, "divided": float(sum(divided))}

    def _behaviour(self, episodes: int) -> Behaviour:
        """What the newest episodes were collected by, its unused nodes left out."""
        active = [prior.hierarchy.active for prior in self.priors]
        controllers = (restricted(c, z) for c, z in zip(self.controllers, active, strict=True))
        explore = (e[z] for e, z in zip(self.explore, active, strict=True))
        return Behaviour(tuple(controllers), tuple(explore), episodes)

    def _sweep(self, update: Update) -> bool:
        """Sample the hierarchies and the posteriors once; whether there was any evidence."""
        data, active = update.data, [prior.hierarchy.active for prior in self.priors]
        team = [
            restricted(p.geometric, nodes) for p, nodes in zip(self.posteriors, active, strict=True)
        ]
        messages = [forward(data, n, controller) for n, controller in enumerate(team)]
        evidence = self.weigh(data, messages)
        if evidence.log_value == -np.inf:
            return False
        self.log_value, share = blended_value(update.log_value, evidence.log_value, update.rate)
        last, weights = reward_steps(data, evidence.shares, self.rng)
        soft, drawn = [], []
        for n, (controller, message) in enumerate(zip(team, messages, strict=True)):
            counts = backward(data, n, controller, message, evidence.shares)
            paths = sample_paths(data, n, controller, message, last, self.rng)
            visits = path_counts(data, n, controller, paths, weights)
            counts, visits = (embedded(c, active[n], self.config.nodes) for c in (counts, visits))
            soft.append(blend(update.statistics[n], counts, share))
            drawn.append(blend(update.sampled[n], visits, share))
        self._resample(soft, drawn, update.scale)
        return True

    def _resample(self, soft: Sequence[Counts], drawn: Sequence[Counts], scale: float) -> None:
        """Resample the hierarchies and take over posteriors and statistics of the nodes left."""
        for prior, counts in zip(self.priors, drawn, strict=True):
            visits = counts.action.sum(axis=1)
            occupied = visits > self.config.node_share * visits.sum()
            occupied[visits.argmax()] = True
            prior.hierarchy = resampled(prior.hierarchy, scaled(counts, scale), occupied, self.rng)
        held = [prior.hierarchy.occupied.astype(np.float64) for prior in self.priors]
        self.statistics = tuple(only(c, nodes) for c, nodes in zip(soft, held, strict=True))
        self.sampled = tuple(only(c, nodes) for c, nodes in zip(drawn, held, strict=True))
        self.adopt(
            [
                prior.update(scaled(counts, scale), posterior)
                for prior, counts, posterior in zip(
                    self.priors, self.statistics, self.posteriors, strict=True
                )
            ]
        )

    def _try_division(self, update: Update) -> bool:
        """Divide a node of one agent, drawn by its visits, where that raises the lower bound."""
        n = int(self.rng.integers(len(self.priors)))
        prior, counts = self.priors[n], self.statistics[n]
        place, visits = prior.hierarchy.special, counts.action.sum(axis=1)
        if place is None:
            return False
        node = int(self.rng.choice(visits.size, p=visits / visits.sum()))
        grown = HierarchicalPrior(prior.actions, prior.hierarchy.divided(node))
        saved, counts = (
            shared_out(each, node, place, self.rng) for each in (update.statistics[n], counts)
        )
        begun = grown.update(scaled(counts, update.scale), self.posteriors[n])
        divided = self._fit(update, n, grown, begun, saved)
        whole = self._fit(update, n, prior, self.posteriors[n], update.statistics[n])
        better = divided.bound > whole.bound
        self._take_over(n, grown if better else prior, divided if better else whole)
        return better

    def _fit(
        self, update: Update, n: int, prior: HierarchicalPrior, posterior: Posterior, saved: Counts
    ) -> Fit:
        """Variational sweeps over one agent's posterior, hierarchy and team-mates held fixed."""
        data, nodes = update.data, prior.hierarchy.active
        messages = [forward(data, m, p.geometric) for m, p in enumerate(self.posteriors) if m != n]
        for sweep in range(self.config.division_sweeps + 1):
            controller = restricted(posterior.geometric, nodes)
            message = forward(data, n, controller)
            evidence = self.weigh(data, [*messages[:n], message, *messages[n:]])
            log_value, share = blended_value(update.log_value, evidence.log_value, update.rate)
            if sweep == self.config.division_sweeps:
                break
            counts = backward(data, n, controller, message, evidence.shares)
            counts = blend(saved, embedded(counts, nodes, self.config.nodes), share)
            posterior = prior.update(scaled(counts, update.scale), posterior)
        fit = log_value if self.config.weighting == "reward" else share * evidence.fit
        return Fit(posterior, counts, update.scale * fit - posterior.divergence, log_value)

    def _take_over(self, n: int, prior: HierarchicalPrior, fit: Fit) -> None:
        """Let an agent have another hierarchy and posterior; a division's visits are soft."""

        def with_nth(values: Sequence[T], new: T) -> tuple[T, ...]:
            return (*values[:n], new, *values[n + 1 :])

        if prior is not self.priors[n]:
            self.priors = with_nth(self.priors, prior)
            self.sampled = with_nth(self.sampled, fit.statistics)
        self.adopt(with_nth(self.posteriors, fit.posterior))
        self.statistics, self.log_value = with_nth(self.statistics, fit.statistics), fit.log_value

    def state_arrays(self) -> Arrays:
        """The learner's state, hierarchies and kept episodes included."""
        arrays = super().state_arrays() | self.pool.state_arrays()
        for n, (prior, counts) in enumerate(zip(self.priors, self.sampled, strict=True)):
            hierarchy = vars(prior.hierarchy).items()
            arrays |= {f"hierarchy_{name}_{n}": np.asarray(value) for name, value in hierarchy}
            arrays |= {f"sampled_{name}_{n}": table for name, table in counts._asdict().items()}
        return arrays

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        for n, prior in enumerate(self.priors):
            prior.hierarchy = restored_hierarchy(arrays, n, self.config.nodes)
        super().restore(arrays, counters)
        self.sampled = tuple(
            restored_counts(arrays, f"sampled_{{}}_{n}", c) for n, c in enumerate(self.controllers)
        )
        sizes = self.spaces.action_sizes, self.spaces.observation_sizes
        self.pool = EpisodePool.restored(arrays, *sizes)
