"""The hierarchical Dirichlet process over nodes as an M-step, and its Gibbs sweep; section 5.2."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bnprl_agents.controllers.controller import Controller, normalised
from bnprl_agents.controllers.dirichlet import dirichlet_divergence, geometric_mean, one_visit
from bnprl_agents.controllers.hdp import (
    GammaPrior,
    sample_row_concentration,
    sample_tables,
    sample_top_concentration,
    sample_weights,
)
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.controllers.priors import Posterior
from bnprl_agents.episodes import BoolArray, FloatArray, IntArray
from bnprl_agents.policy_files import Arrays, taken

ROW_PRIOR: GammaPrior = (10.0, 10.0)
"""Of alpha; shape and rate, as the sampler's source uses such pairs. Section 5.5 calls them "scale"
and "shape", with which the mean would be 100, not 1, and rows would long stay close to beta."""
TOP_PRIOR: GammaPrior = (3.0, 10.0)
"""Of lambda; likewise, with mean .3, not 30."""
SMALLEST = 1e-12
"""Weight of a node at least."""


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

    def divided(self, node: int) -> Hierarchy:
        """The special state becomes a node with half the weight of another.

        Raises:
            ValueError: there is no room.
        """
        place = self.special
        if place is None:
            raise ValueError("no room for another node")
        occupied, weights = self.occupied.copy(), self.weights.copy()
        occupied[place], rest = True, weights[place]
        weights[[node, place]] = weights[node] / 2.0
        grown = Hierarchy(occupied, weights, self.alpha, self.top)
        if grown.special is not None:
            weights[grown.special] = rest
        weights /= weights.sum()
        return grown

    @property
    def active(self) -> IntArray:
        """Places of the occupied nodes and the special state."""
        held = self.occupied.copy()
        if self.special is not None:
            held[self.special] = True
        return np.flatnonzero(held)


def restored_hierarchy(arrays: Arrays, agent: int, room: int) -> Hierarchy:
    """Return the hierarchy of an agent in a policy file, with room for Z nodes.

    Raises:
        ValueError: an array has another shape, or a weight or a concentration is out of range.
    """
    occupied, weights = (
        taken(arrays, f"hierarchy_{name}_{agent}", (room,)) for name in ("occupied", "weights")
    )
    alpha, top = (float(taken(arrays, f"hierarchy_{k}_{agent}", ())) for k in ("alpha", "top"))
    if not (min(alpha, top) > 0.0 and (weights >= 0.0).all()):
        raise ValueError(f"hierarchy_weights_{agent}: weights and concentrations must be positive")
    return Hierarchy(occupied.astype(np.bool_), weights, alpha, top)


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
    fresh[kept.active] = SMALLEST  # a draw may underflow
    fresh[held] = np.maximum(fresh[held], beta[: held.size])
    if kept.special is not None:
        fresh[kept.special] = max(SMALLEST, beta[-1])
    total = int(tables.sum())
    return Hierarchy(
        occupied,
        fresh,
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
        return self.update(one_visit(controller), None)

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
        """The posterior of Dirichlet rows; those of places without a node are the prior's."""
        active, special = self.hierarchy.active, self.hierarchy.special
        mean = Controller(*(normalised(table) for table in parameters))
        held = among(parameters, active)
        nodes = self.hierarchy.alpha * self.hierarchy.weights[active]
        divergence = sum(
            dirichlet_divergence(table, np.broadcast_to(prior, table.shape))
            for table, prior in zip(held, (nodes, self.actions, nodes), strict=True)
        )
        rows = Counts(*(geometric_mean(table) for table in held))
        geometric = embedded(rows, active, self.hierarchy.occupied.size)
        if special is not None:
            geometric.initial[:, special] = mean.initial[:, special]
            geometric.successor[..., special] = mean.successor[..., special]
            geometric.action[special] = mean.action[special]
            geometric.successor[:, :, special] = mean.successor[:, :, special]
        return Posterior(
            mean, Controller(*geometric), divergence, parameters=dict(parameters._asdict())
        )


def among(tables: Counts, nodes: IntArray) -> Counts:
    """The entries of some nodes (n,) and of moves between them."""
    return Counts(
        tables.initial[:, nodes],
        tables.action[nodes],
        tables.successor[:, :, nodes[:, None], nodes],
    )


def restricted(controller: Controller, nodes: IntArray) -> Controller:
    """The controller of some nodes (n,) alone; no other may be reached."""
    return Controller(*among(Counts(*vars(controller).values()), nodes))


def embedded(counts: Counts, nodes: IntArray, room: int) -> Counts:
    """Counts of some nodes (n,) among all places, (Z,) in number; 0 elsewhere."""
    n_observations, n_actions = counts.initial.shape[0], counts.action.shape[1]
    whole = Counts(
        np.zeros((n_observations, room)),
        np.zeros((room, n_actions)),
        np.zeros((*counts.successor.shape[:2], room, room)),
    )
    whole.initial[:, nodes] = counts.initial
    whole.action[nodes] = counts.action
    whole.successor[:, :, nodes[:, None], nodes] = counts.successor
    return whole


def only(counts: Counts, nodes: FloatArray) -> Counts:
    """Counts of some nodes (Z,), 1 or 0, and moves between them."""
    return Counts(
        counts.initial * nodes,
        counts.action * nodes[:, None],
        counts.successor * (nodes[:, None] * nodes),
    )


def shared_out(counts: Counts, node: int, place: int, rng: np.random.Generator) -> Counts:
    """Give an empty place a part of what a node holds, drawn anew for every entry.

    Both keep the sum; parts are Beta(.3, .3), mostly near 0 or 1, so that the two differ.
    """

    def parted(table: FloatArray, axis: int) -> FloatArray:
        columns = np.moveaxis(table.copy(), axis, -1)
        part = rng.beta(0.3, 0.3, size=columns.shape[:-1])
        columns[..., place] = columns[..., node] * part
        columns[..., node] *= 1.0 - part
        return np.moveaxis(columns, -1, axis)

    return Counts(
        parted(counts.initial, 1),
        parted(counts.action, 0),
        parted(parted(counts.successor, 3), 2),
    )
