"""Three nodes (Chowdhary et al. 2014): where batch fitted Q-iteration may diverge."""

from __future__ import annotations

import numpy as np

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.graph import Edge, Graph

NODES = ("left", "middle", "right")
ACTIONS = tuple(f"go-{node}" for node in NODES)
NODE_POSITIONS = (-1.0, 0.0, 1.0)
"""Place of each node on the line; action a, which goes to node a, has the same coordinate."""


def three_nodes() -> TabularModel:
    """Three nodes: all rewards are 0, and fitted Q-iteration with too little noise diverges.

    ## Description
    Three nodes on a line, at -1, 0 and 1 (`NODE_POSITIONS`). Every action leads to its node, for
    certain, from any node. Every policy is worth 0. Gaussian-process fitted Q-iteration that
    begins at 1, with a Gaussian kernel of bandwidth 1 over (node, action), diverges with a noise
    variance of .1 and converges with 1.

    ## Action Space
    `Discrete(3)`: action a goes to node a.

    ## Observation Space
    `Discrete(3)`: the node.

    ## Rewards
    Always 0.

    ## Starting State
    Uniform over the nodes.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Chowdhary, Liu, Grande, Walsh, How and Carin (2014), Off-policy reinforcement learning with
    Gaussian processes, IEEE/CAA Journal of Automatica Sinica 1(3).

    ## Version History
    v0: initial version.

    Returns:
        The model, fully observed: S = 3, A = 3, discount .9999.
    """
    return TabularModel(
        np.repeat(np.eye(3)[:, None], 3, axis=1),
        None,
        0.0,
        np.full(3, 1 / 3),
        discount=0.9999,
        names=Names(NODES, (ACTIONS,), (NODES,), ("agent_0",)),
    )


def three_nodes_scene() -> Graph:
    """Return what the nodes on their line look like."""
    pairs = [(start, end) for start in range(3) for end in range(3) if start != end]
    return Graph(
        positions=[(0.8 * x, 0.0) for x in NODE_POSITIONS],
        labels=NODES,
        edges=[Edge(start, end, end, 0.3 * abs(end - start)) for start, end in pairs],
        actions=ACTIONS,
    )
