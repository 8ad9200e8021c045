"""Meeting in a grid (Bernstein et al. 2005; Amato et al. 2009): find each other unseen."""

from __future__ import annotations

import itertools

import numpy as np

from bnprl_envs.benchmarks.teams import independent, team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

ACTIONS = ("up", "down", "left", "right", "stay")

_STEP = ((-1, 0), (1, 0), (0, -1), (0, 1), (0, 0))  # (row, column) of each action
_INTENDED, _SLIP = 0.6, 0.1  # a move; each of the other directions, and staying


def meeting_grid(size: int = 3) -> TabularModel:
    """Meeting in a grid: two robots that do not see each other try to share a cell.

    ## Description
    The cells of a square grid are numbered row by row, and the robots move without touching each
    other: a move goes where it is meant to with probability .6, in each other direction with .1,
    and stays with .1; a way off the grid is a stay, too. The state is
    `cells * first + second`. With `size=3` the robots must meet in the upper left or the lower
    right corner; with `size=2` any cell will do, but a robot sees only its column.

    ## Action Space
    `Discrete(5)` each: 0 up, 1 down, 2 left, 3 right, 4 stay (which is certain).

    ## Observation Space
    `size=3`: `Discrete(10)` each, 0 to 8 the robot's own cell. `size=2`: `Discrete(3)` each, 0
    and 1 its column, left and right. The last one is the null observation that `reset` returns.

    ## Rewards
    `size=3`: 1 for each step that begins with both robots in cell 0 or both in cell 8.
    `size=2`: 1 for each step that ends with both robots in the same cell.

    ## Starting State
    The robots are in the upper right and the lower left corner.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    `size=3`: 2 gives the small grid.

    ## References
    Bernstein, Hansen and Zilberstein (2005), Bounded policy iteration for decentralized POMDPs,
    IJCAI (2 x 2). Amato, Dibangoye and Zilberstein (2009), Incremental policy generation for
    finite-horizon DEC-POMDPs, ICAPS (3 x 3).

    ## Version History
    v0: initial version.

    Args:
        size: of a side, 2 or 3.

    Returns:
        The model, discount .9: S = 81, A = 5 x 5, O = 9 x 9, or S = 16, A = 5 x 5, O = 2 x 2.

    Raises:
        ValueError: there is no such grid.
    """
    if not isinstance(size, int) or size not in (2, 3):
        raise ValueError(f"size: {size!r}, must be 2 or 3")
    motion, seen = _motion(size), _seen(size)
    n_seen = seen.shape[2]
    cells = range(size**2)
    return TabularModel(
        independent(motion, motion),
        np.repeat(independent(seen, seen), 25, axis=0),
        _reward(size),
        np.eye(size**4)[size**2 * (size - 1) + size**2 - size],
        discount=0.9,
        action_sizes=(5, 5),
        observation_sizes=(n_seen, n_seen),
        names=team_names(
            [f"cells-{first}-{second}" for first in cells for second in cells],
            ACTIONS,
            [f"cell-{cell}" for cell in cells] if size == 3 else ["left", "right"],
        ),
    )


def meeting_grid_scene(size: int = 3) -> Plan:
    """Return what the grid looks like; the goals are the cells where to meet."""
    first, second = np.divmod(np.arange(size**4), size**2)
    return Plan(
        cells=[divmod(cell, size) for cell in range(size**2)],
        pieces=[
            Piece("agent_0", "robot", first, sign="0"),
            Piece("agent_1", "robot", second, sign="1", agent=1),
        ],
        goals=(0, 8) if size == 3 else range(4),
    )


def _motion(size: int) -> FloatArray:
    """Return (5, cells, cells) end cells of one robot."""
    chances = np.zeros((5, size**2, size**2))
    stay = ACTIONS.index("stay")
    chances[stay] = np.eye(size**2)
    for action, way in itertools.product(range(stay), range(5)):
        for row, column in itertools.product(range(size), repeat=2):
            end = (row + _STEP[way][0], column + _STEP[way][1])
            if not all(0 <= place < size for place in end):
                end = (row, column)
            chances[action, size * row + column, size * end[0] + end[1]] += (
                _INTENDED if way == action else _SLIP
            )
    return chances


def _seen(size: int) -> FloatArray:
    """Return (1, cells, observations): the cell, or in the small grid its column."""
    return np.eye(9)[None] if size == 3 else np.tile(np.eye(2), (2, 1))[None]


def _reward(size: int) -> FloatArray:
    """Return rewards that broadcast to (A, S, S', O)."""
    if size == 3:
        return np.isin(np.arange(81), (0, 80)).astype(np.float64)[None, :, None, None]
    return np.eye(4).reshape(1, 1, 16, 1)
