"""The cheese maze (McCallum 1993): cells that look alike and are not."""

from __future__ import annotations

import numpy as np

from bnprl_envs.benchmarks.mazes import COMPASS, compass_ends, maze_model
from bnprl_envs.model import IntArray, Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

_LAYOUT = (
    "*****",
    "* * *",
    "* + *",
)


def cheese_maze(resetting: bool = False) -> TabularModel:
    """Cheese maze: find the middle corridor among three that look alike.

    ## Description
    Eleven cells: a corridor of five and, south of its columns 0, 2 and 4, three corridors of
    two, of which the middle one ends in the cheese. Moves are certain; against a wall they stay.
    The agent sees the walls around its cell, no more. The states are the cells row by row, the
    cheese last:

        0 1 2 3 4
        5 # 6 # 7
        8 # 10# 9

    ## Action Space
    `Discrete(4)`: 0 north, 1 south, 2 east, 3 west.

    ## Observation Space
    `Discrete(8)`: the walls around the cell: 0 north and west (state 0), 1 north and south
    (1, 3), 2 north (2), 3 north and east (4), 4 east and west (5, 6, 7), 5 south, east and west
    (8, 9); 6 the cheese; 7 is the null observation that `reset` returns.

    ## Rewards
    1 on reaching the cheese, else 0.

    ## Starting State
    Uniform over the ten cells without the cheese.

    ## Episode End
    Termination on reaching the cheese; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates; the cheese sends the agent back to the start
    distribution whatever it does, as in the published model file.

    ## References
    McCallum (1993), Overcoming incomplete perception with utile distinction memory, ICML.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 11, A = 4, O = 7, discount .95.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    cells = _cells()
    ends = compass_ends(cells)
    goal = np.arange(len(cells)) == len(cells) - 1
    words, observation = _walls(ends[:, ~goal])
    return maze_model(
        np.eye(goal.size)[ends],
        observation,
        goal,
        discount=0.95,
        resetting=resetting,
        names=Names(
            states=(*(f"cell-{k}" for k in range(goal.size - 1)), "cheese"),
            actions=(COMPASS,),
            observations=((*words, "cheese"),),
            agents=("agent_0",),
        ),
    )


def cheese_maze_scene(**_: object) -> Plan:
    """Return what the maze looks like; the goal is the cheese."""
    cells = _cells()
    mouse = Piece("mouse", "robot", np.arange(len(cells)))
    return Plan(cells, [mouse], goals=[len(cells) - 1])


def _cells() -> list[tuple[int, int]]:
    """Return (row, column) of the free cells, the cheese last."""
    marks = sorted(
        (mark == "+", row, column)
        for row, line in enumerate(_LAYOUT)
        for column, mark in enumerate(line)
        if mark != " "
    )
    return [(row, column) for _, row, column in marks]


def _walls(ends: IntArray) -> tuple[list[str], FloatArray]:
    """Return the kinds of cells, and which is seen where.

    Args:
        ends: (4, S - 1) cells that the moves enter, the goal's left out.

    Returns:
        One word a kind, numbered by first appearance, and the observations (S, O), the last
        state and the last observation being the goal's.
    """
    blocked = ends == np.arange(ends.shape[1])
    seen = ["walls-" + "".join(np.array(list("nesw"))[walls]) for walls in blocked[[0, 2, 1, 3]].T]
    words = list(dict.fromkeys(seen))
    return words, np.eye(len(words) + 1)[[*map(words.index, seen), len(words)]]
