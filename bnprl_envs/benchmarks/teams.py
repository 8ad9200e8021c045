"""What the benchmarks of two agents share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bnprl_envs.model import Names
from bnprl_envs.tables import FloatArray


def independent(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the joint table of two agents that do not touch each other.

    Args:
        first: (A1, X1, Y1), chances of y for each action and x.
        second: (A2, X2, Y2).

    Returns:
        (A1 * A2, X1 * X2, Y1 * Y2); joint indices are row-major, first agent most significant.
    """
    joint: FloatArray = np.einsum("axy,buv->abxuyv", first, second)
    return joint.reshape(np.multiply(first.shape, second.shape))


def team_names(states: Sequence[str], actions: Sequence[str], observations: Sequence[str]) -> Names:
    """Return the words of a team of two agents that have the same actions and observations."""
    return Names(
        states=tuple(states),
        actions=(tuple(actions),) * 2,
        observations=(tuple(observations),) * 2,
        agents=("agent_0", "agent_1"),
    )
