"""Node-wise exploration: a node exploits as far as it has been rewarded; (2.46), (2.47)."""

from __future__ import annotations

import numpy as np

from bnprl_agents.episodes import FloatArray


def exploring_probability(
    occupancy: FloatArray, prior: float, rng: np.random.Generator
) -> FloatArray:
    """Draw each node's probability of exploring, 1 - Beta(u0, u1); (6.17), (6.18).

    Args:
        occupancy: (Z,) u0, the value-weighted number of visits of each node.
        prior: u1 > 0; larger values explore longer.
        rng: source of the draws.

    Returns:
        (Z,) probabilities; a node that was never occupied (u0 = 0) always explores.
    """
    occupied = occupancy > 0.0
    exploit = rng.beta(np.where(occupied, occupancy, 1.0), prior)
    return np.where(occupied, 1.0 - exploit, 1.0)


def exploration_suffices(
    exploring: float, discount: float, tolerance: float, largest_reward: float
) -> bool:
    """Whether exploring less than this changes the value by less than `tolerance`; Theorem 12.

    The threshold on the team's probability of exploring is (1 - gamma) tolerance / R_max. Where
    nothing has been earned, R_max is not known yet, and nothing suffices.
    """
    return largest_reward > 0.0 and exploring * largest_reward < (1.0 - discount) * tolerance


def team_exploring(exploring: FloatArray) -> FloatArray:
    """Probability (S,) that some agent of the team explores, from each agent's own (S, N)."""
    exploiting: FloatArray = np.prod(1.0 - exploring, axis=1)
    return 1.0 - exploiting
