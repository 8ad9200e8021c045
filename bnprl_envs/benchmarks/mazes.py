"""What the mazes share: compass moves, and a goal that ends the episode or restarts it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bnprl_envs.arguments import checked_flag
from bnprl_envs.model import IntArray, Names, TabularModel
from bnprl_envs.tables import BoolArray, FloatArray

NORTH, SOUTH, EAST, WEST = range(4)
COMPASS = ("north", "south", "east", "west")

_STEP = ((-1, 0), (1, 0), (0, 1), (0, -1))  # (row, column) of north, south, east, west


def compass_ends(cells: Sequence[tuple[int, int]]) -> IntArray:
    """Return the cell that each move enters; a move without a neighbour stays.

    Args:
        cells: (row, column) of every free cell; row 0 is the northernmost.

    Returns:
        (4, S) indices of cells, for north, south, east and west.
    """
    number = {cell: k for k, cell in enumerate(cells)}
    return np.array(
        [
            [number.get((row + down, column + right), k) for k, (row, column) in enumerate(cells)]
            for down, right in _STEP
        ]
    )


def maze_model(
    moves: npt.ArrayLike,
    observation: FloatArray,
    goal: BoolArray,
    *,
    discount: float,
    resetting: bool,
    names: Names,
) -> TabularModel:
    """Build the model of a maze: the start is uniform outside the goal, entering it earns 1.

    Args:
        moves: (A, S, S) end states, the goal treated as any cell.
        observation: (S', O) observations, the same after every action.
        goal: (S,) whether a state is in the goal.
        discount: factor in (0, 1].
        resetting: whether every action in the goal leads to the start distribution, for 0 (else
            the goal is terminal).
        names: words for the indices.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    checked_flag("resetting", resetting)
    start = ~goal / np.count_nonzero(~goal)
    transition = np.array(moves, dtype=np.float64)
    transition[:, goal] = start if resetting else np.eye(goal.size)[goal]
    return TabularModel(
        transition,
        np.broadcast_to(observation, (len(transition), *observation.shape)),
        (~goal[:, None] & goal)[None, :, :, None],
        start,
        discount,
        terminal=None if resetting else goal,
        names=names,
    )
