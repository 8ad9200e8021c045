"""Gridworld (Chowdhary et al. 2014): the smallest maze whose state is seen."""

from __future__ import annotations

from numbers import Real

import numpy as np
from scipy.sparse import csr_array

from bnprl_envs.arguments import checked_count
from bnprl_envs.benchmarks.mazes import COMPASS, compass_ends
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray


def gridworld(rows: int = 5, columns: int = 5, slip: float = 0.1) -> TabularModel:
    """Gridworld: walk from the lower left to the upper right corner of an open grid.

    ## Description
    An open grid of 5 x 5 cells. The state is the cell, `columns * row + column`, row 0 being the
    northernmost; the agent sees it. A move goes one cell and stays in place with probability .1;
    against the border it stays for certain.

    ## Action Space
    `Discrete(4)`: 0 north, 1 south, 2 east, 3 west.

    ## Observation Space
    `Discrete(25)`: the state. `gridworld_positions` gives the coordinates of every state, for
    agents with kernels or features.

    ## Rewards
    1 on entering the goal, else 0.

    ## Starting State
    The lower left corner, state 20.

    ## Episode End
    Termination on entering the upper right corner, state 4; truncation after 200 steps.

    ## Arguments
    `rows=5`, `columns=5`: the size of the grid, at least two cells. `slip=0.1`: the probability
    of staying in place, in [0, 1).

    ## References
    Chowdhary, Liu, Grande, Walsh, How and Carin (2014), Off-policy reinforcement learning with
    Gaussian processes, IEEE/CAA Journal of Automatica Sinica 1(3).

    ## Version History
    v0: initial version.

    Args:
        rows: height of the grid.
        columns: width of the grid.
        slip: probability that a move stays in place.

    Returns:
        The model, fully observed: S = rows * columns, A = 4, discount .9.

    Raises:
        ValueError: a size is no integer above 0, the grid has a single cell, or slip is outside
            [0, 1).
    """
    rows, columns = checked_count("rows", rows), checked_count("columns", columns)
    if rows * columns < 2:
        raise ValueError("rows, columns: 1, 1, must make at least two cells")
    if not isinstance(slip, Real) or not 0.0 <= slip < 1.0:
        raise ValueError(f"slip: {slip!r}, must lie in [0, 1)")
    start, goal = columns * (rows - 1), columns - 1
    states = np.arange(rows * columns)
    ends = compass_ends([divmod(state, columns) for state in states.tolist()])
    ends[:, goal] = goal
    here = np.broadcast_to(states, ends.shape)
    shape = (ends.size, states.size)
    row = np.arange(ends.size)
    moved = csr_array((np.full(ends.size, 1.0 - slip), (row, ends.ravel())), shape=shape)
    slipped = csr_array((np.full(ends.size, slip), (row, here.ravel())), shape=shape)
    entering = np.flatnonzero((ends == goal) & (here != goal))
    return TabularModel(
        csr_array(moved + slipped),
        None,
        csr_array((np.ones(entering.size), (entering, np.full(entering.size, goal))), shape=shape),
        states == start,
        discount=0.9,
        terminal=states == goal,
        names=_names(states.size),
    )


def gridworld_positions(rows: int = 5, columns: int = 5) -> FloatArray:
    """Return the coordinates (S, 2) of the states: x from 1 eastwards, y from 1 northwards."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.stack([column + 1.0, rows - row], axis=1)


def gridworld_scene(rows: int = 5, columns: int = 5, **_: object) -> Plan:
    """Return what the grid looks like."""
    cells = [divmod(state, columns) for state in range(rows * columns)]
    return Plan(cells, [Piece("agent", "robot", np.arange(len(cells)))], goals=[columns - 1])


def _names(n_states: int) -> Names:
    cells = tuple(f"cell-{k}" for k in range(n_states))
    return Names(states=cells, actions=(COMPASS,), observations=(cells,), agents=("agent_0",))
