"""Settings of the infinite RPR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bnprl_agents.controllers.variational import BayesianConfig


@dataclass(frozen=True)
class InfiniteRPRConfig(BayesianConfig):
    """Settings of `InfiniteRPR`. Silent in the source, or other than printed, and chosen here.

    alpha ~ Ga(10, 10) and lambda ~ Ga(3, 10) are read as shape and rate, where section 5.5 has
    scale and shape; see `hierarchy.ROW_PRIOR`. An episode's occupancy is one path, up to a reward
    drawn in proportion to nu_t, with all of the episode's nu. The special state enters the E-step
    with its expected weight. Old episodes are weighed against the mixture of all policies so far,
    not against the one that collected them.
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
    exploration_prior: float = 2.0
    """u1 of the Beta distribution from which a node's exploitation is drawn; larger explores."""
    evidence_per_episode: float = 16.0
    """Observations as which one episode weighs against the prior in the end, where evidence_scale
    is 0. At 1 the price of a node's rows, some 50 nats, is above what memory gains in a thousand
    episodes where policies differ by a few per cent in value."""
    sharpening_episodes: float = 500.0
    """Episodes after which an episode weighs half of that: a policy sharpened by few of them stops
    trying other actions."""
    divisions: int = 2
    """Proposals an update to divide a node in two; one is taken where it raises the lower bound.
    Not in the source: the special state alone seldom breaks the symmetry of two equal nodes."""
    division_sweeps: int = 15
    """Variational sweeps before the bounds with and without the division are compared."""
    schedule: Literal["batch", "online"] = "batch"
    """batch: all episodes so far are kept and swept over, as in the source. online: running means
    of the statistics, and only the newest episodes are kept (the dissertation's future work)."""
    node_share: float = 0.0002
    """A node is occupied where its part of the sampled, reward-weighted visits exceeds this; the
    most visited one always is."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.schedule == "batch" and self.weighting != "reward":
            raise ValueError(
                f"weighting: {self.weighting!r}, must be 'reward' with the batch schedule, whose "
                "episodes are of older policies, too"
            )
        if not 1 <= self.initial_nodes < self.nodes:
            raise ValueError(
                f"initial_nodes: {self.initial_nodes}, must lie in [1, nodes - 1], nodes is "
                f"{self.nodes}"
            )
        if not 0.0 < self.evidence_per_episode < np.inf:
            raise ValueError(
                f"evidence_per_episode: {self.evidence_per_episode}, must be positive and finite"
            )
        if not 0.0 <= self.sharpening_episodes < np.inf:
            raise ValueError(
                f"sharpening_episodes: {self.sharpening_episodes}, must be finite, not negative"
            )
        if self.divisions < 0 or self.division_sweeps < 1:
            raise ValueError(
                f"divisions: {self.divisions}, division_sweeps: {self.division_sweeps}; must be at "
                "least 0 and 1"
            )
        if not 0.0 <= self.node_share < 1.0:
            raise ValueError(f"node_share: {self.node_share}, must lie in [0, 1)")
