"""Which agents of a team share their tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bnprl_agents.episodes import IntArray


def shared_roles(
    action_sizes: Sequence[int], observation_sizes: Sequence[int], largest_team: int
) -> tuple[IntArray, IntArray]:
    """Role of each agent (N,), and one agent of each role (M,).

    In a team larger than `largest_team` agents of equal spaces have the same role; in a smaller
    one everybody has a role of its own.
    """
    sizes = np.stack([action_sizes, observation_sizes], axis=1)
    if len(sizes) <= largest_team:
        return np.arange(len(sizes)), np.arange(len(sizes))
    _, members, roles = np.unique(sizes, axis=0, return_index=True, return_inverse=True)
    return roles.ravel(), members
