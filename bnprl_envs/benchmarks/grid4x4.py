"""The 4x4 grid (Cassandra, Kaelbling and Littman 1994): find the corner without seeing anything."""

from __future__ import annotations

import numpy as np

from bnprl_envs.benchmarks.mazes import COMPASS, compass_ends, maze_model
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan

_SIZE = 4
_GOAL = _SIZE**2 - 1
_CELLS = [divmod(cell, _SIZE) for cell in range(_SIZE**2)]  # (row, column)


def grid4x4(resetting: bool = False) -> TabularModel:
    """4x4 grid: walk blindly to a corner of an open grid.

    ## Description
    An open grid of 4 x 4 cells. The state is the cell, row by row from the northernmost; the
    goal is the south-eastern corner, state 15. Moves are certain; against the border they stay.
    The agent learns nothing but that it has arrived.

    ## Action Space
    `Discrete(4)`: 0 north, 1 south, 2 east, 3 west.

    ## Observation Space
    `Discrete(3)`: 0 nothing, 1 the goal; 2 is the null observation that `reset` returns.

    ## Rewards
    1 on entering the goal, else 0.

    ## Starting State
    Uniform over the 15 cells outside the goal.

    ## Episode End
    Termination on entering the goal; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates; the goal sends the agent back to the start
    distribution whatever it does, as in the published model file.

    ## References
    Cassandra, Kaelbling and Littman (1994), Acting optimally in partially observable stochastic
    domains, AAAI.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 16, A = 4, O = 2, discount .95.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    ends = compass_ends(_CELLS)
    goal = np.arange(_SIZE**2) == _GOAL
    return maze_model(
        np.eye(goal.size)[ends],
        np.stack([~goal, goal], axis=1).astype(np.float64),
        goal,
        discount=0.95,
        resetting=resetting,
        names=Names(
            states=(*(f"cell-{k}" for k in range(_GOAL)), "goal"),
            actions=(COMPASS,),
            observations=(("nothing", "goal"),),
            agents=("agent_0",),
        ),
    )


def grid4x4_scene(**_: object) -> Plan:
    """Return what the grid looks like."""
    return Plan(_CELLS, [Piece("agent", "robot", np.arange(len(_CELLS)))], goals=[_GOAL])
