"""The infinite regionalized policy representation (iRPR), chapter 5: nodes are born and dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.controllers.dirichlet import geometric_mean
from bnprl_agents.controllers.hdp import (
    GammaPrior,
    sample_row_concentration,
    sample_tables,
    sample_top_concentration,
    sample_weights,
)
from bnprl_agents.controllers.messages import Counts, Messages, backward, forward
from bnprl_agents.controllers.nested_em import blended_value
from bnprl_agents.controllers.paths import path_counts, sample_paths
from bnprl_agents.controllers.priors import Posterior, Prior, blend, scaled
from bnprl_agents.controllers.variational import BayesianConfig, BayesianEM
from bnprl_agents.episodes import BoolArray, EpisodeBatch, FloatArray, IntArray
from bnprl_agents.policy_files import Arrays

ROW_PRIOR: GammaPrior = (10.0, 10.0)
"""Of alpha, section 5.5, read as shape and rate."""
TOP_PRIOR: GammaPrior = (3.0, 10.0)
"""Of lambda."""


@dataclass(frozen=True)
class Hierarchy:
    """What one agent's rows share, with room for Z nodes.

    Attributes:
        occupied: (Z,) nodes that hold something.
        weights: (Z,) beta of the occupied nodes and, at the first free place, of the special
            state that stands for all others; 0 elsewhere.
        alpha: concentration of the rows around beta.
        top: lambda, concentration of beta.
    """

    occupied: BoolArray
    weights: FloatArray
    alpha: float
    top: float

    @property
    def special(self) -> int | None:
        """Place of the special state; None where there is no room for another node."""
        free = np.flatnonzero(~self.occupied)
        return int(free[0]) if free.size else None

    @property
    def active(self) -> IntArray:
        """Places of the occupied nodes and the special state."""
        held = self.occupied.copy()
        if self.special is not None:
            held[self.special] = True
        return np.flatnonzero(held)


def first_hierarchy(room: int, nodes: int) -> Hierarchy:
    """Equal weights for the first nodes and the special state; concentrations at prior means."""
    occupied = np.arange(room) < nodes
    weights = np.where(np.arange(room) <= nodes, 1.0, 0.0)
    alpha, top = ROW_PRIOR[0] / ROW_PRIOR[1], TOP_PRIOR[0] / TOP_PRIOR[1]
    return Hierarchy(occupied, weights / weights.sum(), alpha, top)


def resampled(
    hierarchy: Hierarchy, counts: Counts, occupied: BoolArray, rng: np.random.Generator
) -> Hierarchy:
    """One Gibbs sweep over m, beta, alpha and lambda, given sampled occupancies.

    A special state that is occupied becomes a node, with a part Beta(1, lambda) of its weight; a
    node that is not goes back to the special state.

    Args:
        hierarchy: the current one.
        counts: phi, of sampled paths.
        occupied: (Z,) places that hold something now.
        rng: source of the draws.
    """
    weights, special = hierarchy.weights.copy(), hierarchy.special
    if special is not None and occupied[special]:
        weights[special] *= rng.beta(1.0, hierarchy.top)
    held = np.flatnonzero(occupied)
    rows = np.concatenate(
        [counts.initial, counts.successor[:, :, held].reshape(-1, counts.initial.shape[1])]
    )[:, held]
    tables = sample_tables(rows, hierarchy.alpha * weights[held], rng).sum(axis=0)
    kept = replace(hierarchy, occupied=occupied)
    beta = sample_weights(tables, hierarchy.top, rng)
    if kept.special is None:
        beta = beta[:-1] / beta[:-1].sum()
    fresh = np.zeros_like(weights)
    fresh[held] = beta[: held.size]
    if kept.special is not None:
        fresh[kept.special] = beta[-1]
    total = int(tables.sum())
    return Hierarchy(
        occupied,
        np.maximum(fresh, np.where(fresh > 0.0, 1e-12, 0.0)),
        sample_row_concentration(hierarchy.alpha, rows.sum(axis=1), total, ROW_PRIOR, rng),
        sample_top_concentration(hierarchy.top, held.size, total, TOP_PRIOR, rng),
    )


class HierarchicalPrior:
    """Dirichlet rows alpha beta over the active nodes, (5.9); places without a node have weight 0.

    The special state enters the E-step with its expected weight: exp(E ln) of a node without
    evidence is practically 0, and no node would ever be born.

    Args:
        actions: (A,) Dirichlet parameters of every row over actions.
        hierarchy: see `Hierarchy`; replaced in every sweep.
    """

    def __init__(self, actions: FloatArray, hierarchy: Hierarchy) -> None:
        self.actions, self.hierarchy = actions, hierarchy

    def around(self, controller: Controller) -> Posterior:
        """The prior plus the controller's rows, as from one visit of every entry."""
        visits = Counts(
            controller.n_nodes * controller.initial,
            controller.n_actions * controller.action,
            controller.n_nodes * controller.successor,
        )
        return self.update(visits, None)

    def update(self, counts: Counts, old: Posterior | None) -> Posterior:
        """Return prior + counts; what the counts hold in places without a node is left out."""
        held = self.hierarchy.occupied
        nodes = self.hierarchy.alpha * self.hierarchy.weights
        occupied = held.astype(np.float64)
        return self._posterior(
            Counts(
                nodes + counts.initial * occupied,
                self.actions + counts.action * occupied[:, None],
                nodes + counts.successor * (occupied[:, None] * occupied),
            )
        )

    def restore(self, mean: Controller, parameters: Arrays) -> Posterior:
        """Build a saved posterior again."""
        return self._posterior(Counts(*(parameters[name] for name in Counts._fields)))

    def _posterior(self, parameters: Counts) -> Posterior:
        active, special = self.hierarchy.active, self.hierarchy.special
        mean = Controller(*(normalised(table) for table in parameters))

        def geometric(table: FloatArray) -> FloatArray:
            rows = np.zeros_like(table)
            rows[..., active] = geometric_mean(table[..., active])
            return rows

        initial, successor = geometric(parameters.initial), geometric(parameters.successor)
        action = geometric_mean(parameters.action)
        if special is not None:
            initial[:, special] = mean.initial[:, special]
            successor[..., special] = mean.successor[..., special]
            action[special], successor[:, :, special] = (
                mean.action[special],
                mean.successor[:, :, special],
            )
        return Posterior(
            mean, Controller(initial, action, successor), parameters=dict(parameters._asdict())
        )


@dataclass(frozen=True)
class InfiniteRPRConfig(BayesianConfig):
    """Settings of `InfiniteRPR`. Silent or ambiguous in the source, and chosen here.

    alpha ~ Ga(10, 10) and lambda ~ Ga(3, 10) are read as shape and rate. An episode's occupancy is
    one path, up to a reward drawn in proportion to nu_t, with all of the episode's nu. The special
    state enters the E-step with its expected weight.
    """

    nodes: int = 30
    """Room for nodes: as many can be in use at once; memory and time are bounded by it."""
    initial_nodes: int = 12
    """Nodes in use at first."""
    successor_concentration: float = 0.1
    """Of the Dirichlet from which the first successor rows are drawn. At 1 (uniform) nodes average
    the memory of an observation away and are dropped before they are told apart."""
    batch_episodes: int = 20
    """New episodes between two updates; the source updates after each."""
    outer_iterations: int = 5
    """Sweeps of the hybrid sampler an update."""
    exploration_prior: float = 50.0
    """u1 of the Beta distribution from which a node's exploitation is drawn; larger explores. The
    source's 2 stops exploring within a hundred episodes here, where u0 counts every visit."""
    schedule: Literal["batch", "online"] = "batch"
    """batch: all episodes so far are kept and swept over, as in the source. online: running means
    of the statistics, and only the newest episodes are kept (the dissertation's future work)."""
    node_share: float = 0.0002
    """A node is occupied where its part of the sampled, reward-weighted visits exceeds this."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.initial_nodes < self.nodes:
            raise ValueError(
                f"initial_nodes: {self.initial_nodes}, must lie in [1, nodes - 1], nodes is "
                f"{self.nodes}"
            )
        if not 0.0 <= self.node_share < 1.0:
            raise ValueError(f"node_share: {self.node_share}, must lie in [0, 1)")


class InfiniteRPR(BayesianEM):
    """Controllers under a hierarchical Dirichlet process, by a hybrid Gibbs-variational sampler.

    A sweep takes nu and the nodes' posterior from the variational E-step, draws occupancies from
    it, and given these the nodes in use, the table counts m, beta, alpha and lambda. Nodes that
    hold nothing go back to the special state; where that is occupied a node is born. The special
    state and all nodes without reward always explore (unseen histories); the others as long as
    they were rewarded little against u1 (seen histories).

    Paper: Liu, Liao and Carin, The infinite regionalized policy representation, ICML 2011;
    dissertation, sections 5.2 and 5.3.
    """

    Config = InfiniteRPRConfig
    config: InfiniteRPRConfig
    priors: tuple[HierarchicalPrior, ...]

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
        self.kept: EpisodeBatch | None = None

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

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Learn from new episodes; see `NestedEM.learn`. Also returns the mean number of nodes."""
        metrics = super().learn(episodes)
        metrics.pop("bound", None)
        used = [int(prior.hierarchy.occupied.sum()) for prior in self.priors]
        return metrics | {"nodes": float(np.mean(used))}

    def improve(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Metrics:
        """Sweep over all episodes so far, or online over the newest."""
        rate, scale = self.learning_rate(data), self.evidence_scale(data)
        if self.config.schedule == "batch":
            kept = [data] if self.kept is None else [self.kept, data]
            data = self.kept = EpisodeBatch.concatenate(kept)
        saved, sampled, log_saved = self.statistics, self.sampled, self.log_value
        for _ in range(self.config.outer_iterations):
            messages = [forward(data, n, p.geometric) for n, p in enumerate(self.posteriors)]
            evidence = self.weigh(data, messages)
            if evidence.log_value == -np.inf:
                self.log_value += np.log1p(-rate) if rate < 1.0 else 0.0
                return {"unchanged": 1.0}
            self.log_value, share = blended_value(log_saved, evidence.log_value, rate)
            last, weights = reward_steps(data, evidence.shares, self.rng)
            soft, drawn = [], []
            for n, (posterior, message) in enumerate(zip(self.posteriors, messages, strict=True)):
                counts = backward(data, n, posterior.geometric, message, evidence.shares)
                soft.append(blend(saved[n], counts, share))
                nodes = sample_paths(data, n, posterior.geometric, message, last, self.rng)
                visited = path_counts(data, n, posterior.geometric, nodes, weights)
                drawn.append(blend(sampled[n], visited, share))
            self.statistics, self.sampled = self._sweep(soft, drawn, scale)
        return {"learning_rate": rate}

    def _sweep(
        self, soft: Sequence[Counts], drawn: Sequence[Counts], scale: float
    ) -> tuple[tuple[Counts, ...], tuple[Counts, ...]]:
        """Resample the hierarchies and take over the posteriors; return statistics of nodes."""
        for prior, counts in zip(self.priors, drawn, strict=True):
            visits = counts.action.sum(axis=1)
            occupied = visits > self.config.node_share * visits.sum()
            prior.hierarchy = resampled(prior.hierarchy, scaled(counts, scale), occupied, self.rng)
        held = [prior.hierarchy.occupied.astype(np.float64) for prior in self.priors]
        soft = [only(counts, nodes) for counts, nodes in zip(soft, held, strict=True)]
        drawn = [only(counts, nodes) for counts, nodes in zip(drawn, held, strict=True)]
        self.adopt(
            [
                prior.update(scaled(counts, scale), posterior)
                for prior, counts, posterior in zip(self.priors, soft, self.posteriors, strict=True)
            ]
        )
        return tuple(soft), tuple(drawn)

    def state_arrays(self) -> Arrays:
        """The learner's state, hierarchies and kept episodes included."""
        arrays = super().state_arrays()
        for n, (prior, counts) in enumerate(zip(self.priors, self.sampled, strict=True)):
            hierarchy = vars(prior.hierarchy).items()
            arrays |= {f"hierarchy_{name}_{n}": np.asarray(value) for name, value in hierarchy}
            arrays |= {f"sampled_{name}_{n}": table for name, table in counts._asdict().items()}
        if self.kept is not None:
            arrays |= {f"kept_{name}": table for name, table in vars(self.kept).items()}
        return arrays

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        for n, prior in enumerate(self.priors):
            prior.hierarchy = Hierarchy(
                arrays[f"hierarchy_occupied_{n}"],
                arrays[f"hierarchy_weights_{n}"],
                float(arrays[f"hierarchy_alpha_{n}"]),
                float(arrays[f"hierarchy_top_{n}"]),
            )
        super().restore(arrays, counters)
        self.sampled = tuple(
            Counts(*(arrays[f"sampled_{name}_{n}"] for name in Counts._fields))
            for n in range(len(self.controllers))
        )
        kept = {
            name.removeprefix("kept_"): table
            for name, table in arrays.items()
            if name.startswith("kept_")
        }
        self.kept = EpisodeBatch(**kept) if kept else None


def reward_steps(
    episodes: EpisodeBatch, shares: FloatArray, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Draw each episode's step t in proportion to nu_t.

    Returns:
        (K,) rows of the steps, one before the first row where an episode has no reward; and (S,)
        the sum of the episode's shares, at each of its steps.
    """
    first, lengths = episodes.offsets[:-1], episodes.lengths
    total = np.add.reduceat(shares, first)
    ahead = np.cumsum(shares)
    before = ahead[first] - shares[first]
    wanted = before + rng.random(total.size) * total
    last = np.minimum(np.searchsorted(ahead, wanted, side="right"), first + lengths - 1)
    return np.where(total > 0.0, last, first - 1), np.repeat(total, lengths)


def only(counts: Counts, nodes: FloatArray) -> Counts:
    """Counts of some nodes (Z,), 1 or 0, and moves between them."""
    return Counts(
        counts.initial * nodes,
        counts.action * nodes[:, None],
        counts.successor * (nodes[:, None] * nodes),
    )
