"""The noisy one-dimensional maze (Littman): four cells in a row."""

from __future__ import annotations

import numpy as np

from bnprl_envs.benchmarks.mazes import EAST, WEST, compass_ends, maze_model
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan

_ORDER = ("left", "middle", "goal", "right")  # from west to east
_STATES = ("left", "middle", "right", "goal")
_CELLS = [(0, _ORDER.index(state)) for state in _STATES]
_SUCCEEDS = 0.9  # chance of the direction meant; else the opposite one


def noisy_maze_1d(resetting: bool = False) -> TabularModel:
    """Noisy one-dimensional maze: find the goal in a row of four cells, blindly.

    ## Description
    Four cells from west to east: left, middle, goal, right; as states 0, 1, 3 and 2. A move goes
    one cell in the direction meant with probability .9, in the opposite one with .1; against
    either end it stays. The agent learns nothing but that it has arrived.

    ## Action Space
    `Discrete(2)`: 0 west, 1 east.

    ## Observation Space
    `Discrete(3)`: 0 nothing, 1 the goal; 2 is the null observation that `reset` returns.

    ## Rewards
    1 on entering the goal, else 0.

    ## Starting State
    Uniform over the three cells outside the goal.

    ## Episode End
    Termination on entering the goal; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates; the goal sends the agent back to the start
    distribution whatever it does, as in the published model file.

    ## References
    Littman, stochastic version of his one-dimensional maze; published as `1d.noisy.POMDP` with
    Cassandra's pomdp-solve.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 4, A = 2, O = 2, discount .75.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    ends = np.eye(4)[compass_ends(_CELLS)]
    meant = ends[[WEST, EAST]]
    goal = np.array([state == "goal" for state in _STATES])
    return maze_model(
        _SUCCEEDS * meant + (1.0 - _SUCCEEDS) * meant[::-1],
        np.stack([~goal, goal], axis=1).astype(np.float64),
        goal,
        discount=0.75,
        resetting=resetting,
        names=Names(_STATES, (("west", "east"),), (("nothing", "goal"),), ("agent_0",)),
    )


def noisy_maze_1d_scene(**_: object) -> Plan:
    """Return what the row of cells looks like."""
    agent = Piece("agent", "robot", np.arange(len(_STATES)))
    labels = dict(enumerate(_STATES))
    return Plan(_CELLS, [agent], goals=[_STATES.index("goal")], labels=labels)
