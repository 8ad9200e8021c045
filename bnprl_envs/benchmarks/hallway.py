"""Hallway and Hallway2 (Littman, Cassandra and Kaelbling 1995): a robot in office corridors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from bnprl_envs.benchmarks.mazes import maze_model
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

NORTH, EAST, SOUTH, WEST = range(4)
ACTIONS = ("stay", "forward", "turn-right", "turn-around", "turn-left")

_STEP = ((-1, 0), (0, 1), (1, 0), (0, -1))  # (row, column) of north, east, south, west
_TURNS = {  # action -> chance of ending 0, 1, 2, 3 quarter turns further right
    "stay": (1.0, 0.0, 0.0, 0.0),
    "turn-right": (0.1, 0.7, 0.1, 0.1),
    "turn-around": (0.1, 0.15, 0.6, 0.15),
    "turn-left": (0.1, 0.1, 0.1, 0.7),
}
_FORWARD = (  # (chance, quarter turns to the neighbour entered, quarter turns of the robot)
    (0.8, 0, 0),
    (0.05, 1, 1),
    (0.05, 3, 3),
    (0.025, 2, 2),
    (0.025, 2, 0),
)
_SEES_WALL = 0.9  # chance of the sensor where there is a wall
_SEES_PHANTOM = 0.05  # and where there is none

_LAYOUT = (
    "***********",
    "  * * * +  ",
)
_LANDMARKS = {(2, SOUTH): 16, (4, SOUTH): 17, (6, SOUTH): 18, (8, SOUTH): 19}
_LAYOUT_2 = (
    " ***** ",
    "** * **",
    " * * * ",
    "** * *+",
    " ***** ",
)


def hallway(resetting: bool = False) -> TabularModel:
    """Hallway: reach a room at the end of a corridor with noisy motion and noisy wall sensors.

    ## Description
    Fifteen cells: a corridor of eleven, and four rooms south of its columns 2, 4, 6 and 8, of
    which the last is the goal. The robot does not know where it starts nor which way it faces;
    four landmarks, seen only on looking into the rooms, break the corridor's symmetry. The state
    is the cell and the orientation, `4 * cell + orientation` (north, east, south, west).

    ## Action Space
    `Discrete(5)`: 0 stay, 1 forward, 2 turn right, 3 turn around, 4 turn left. All but 0 are
    noisy: forward succeeds with probability .8, a quarter turn with .7, turning around with .6.

    ## Observation Space
    `Discrete(22)`: 0 to 15 are the walls seen (8 front + 4 right + 2 back + 1 left), each by a
    sensor that sees a wall with probability .9 and imagines one with .05; 16 to 19 are the
    landmarks; 20 is the goal; 21 is the null observation that `reset` returns.

    ## Rewards
    1 on entering the goal, else 0.

    ## Starting State
    Uniform over the 56 states outside the goal.

    ## Episode End
    Termination on entering the goal; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates; the goal sends the robot back to the start
    distribution whatever it does, as in the published model file.

    ## References
    Littman, Cassandra and Kaelbling (1995), Learning policies for partially observable
    environments: scaling up, ICML.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 60, A = 5, O = 21, discount .95.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    return corridor_model(_LAYOUT, landmarks=_LANDMARKS, n_observations=21, resetting=resetting)


def hallway2(resetting: bool = False) -> TabularModel:
    """Hallway2: a larger building than Hallway, and no landmarks.

    ## Description
    Twenty-three cells: a ring of corridors, one corridor across it from north to south, and
    four dead ends, two to the west and two to the east, of which the south-eastern one is the
    goal. The robot does not know where it starts nor which way it faces, and the building is
    symmetric but for the goal. The state is the cell and the orientation,
    `4 * cell + orientation` (north, east, south, west).

    ## Action Space
    `Discrete(5)`: 0 stay, 1 forward, 2 turn right, 3 turn around, 4 turn left. All but 0 are
    noisy: forward succeeds with probability .8, a quarter turn with .7, turning around with .6.

    ## Observation Space
    `Discrete(18)`: 0 to 15 are the walls seen (8 front + 4 right + 2 back + 1 left), each by a
    sensor that sees a wall with probability .9 and imagines one with .05; 16 is the goal; 17 is
    the null observation that `reset` returns.

    ## Rewards
    1 on entering the goal, else 0.

    ## Starting State
    Uniform over the 88 states outside the goal.

    ## Episode End
    Termination on entering the goal; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates; the goal sends the robot back to the start
    distribution whatever it does, as in the published model file.

    ## References
    Littman, Cassandra and Kaelbling (1995), Learning policies for partially observable
    environments: scaling up, ICML.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 92, A = 5, O = 17, discount .95.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    return corridor_model(_LAYOUT_2, landmarks={}, n_observations=17, resetting=resetting)


def corridor_model(
    layout: Sequence[str],
    *,
    landmarks: Mapping[tuple[int, int], int],
    n_observations: int,
    resetting: bool,
) -> TabularModel:
    """Build the model of a robot in a corridor drawn as text.

    Args:
        layout: lines of one length; ` ` is solid, `*` free, `+` the goal. Free cells are
            numbered row by row.
        landmarks: (cell, orientation) -> the observation that is certain there.
        n_observations: O; the last one is the goal.
        resetting: whether the goal restarts (else it is terminal).

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    cells = _cells(layout)
    number = {cell: k for k, cell in enumerate(cells)}
    neighbour = [[number.get((r + dr, c + dc)) for dr, dc in _STEP] for r, c in cells]
    in_goal = np.repeat([layout[r][c] == "+" for r, c in cells], 4)

    observation = np.zeros((in_goal.size, n_observations))
    observation[:, :16] = [_wall_sensors(walls) for walls in _relative_walls(neighbour)]
    for (cell, facing), landmark in landmarks.items():
        observation[4 * cell + facing] = np.eye(n_observations)[landmark]
    observation[in_goal] = np.eye(n_observations)[-1]
    return maze_model(
        [_moves(action, neighbour) for action in ACTIONS],
        observation,
        in_goal,
        discount=0.95,
        resetting=resetting,
        names=_names(len(cells), n_observations),
    )


def hallway_scene(**_: object) -> Plan:
    """Return what Hallway looks like; the landmarks' rooms have their observations' numbers."""
    return _plan(_LAYOUT, {11: "16", 12: "17", 13: "18", 14: "19"})


def hallway2_scene(**_: object) -> Plan:
    """Return what Hallway2 looks like."""
    return _plan(_LAYOUT_2, {})


def _plan(layout: Sequence[str], labels: Mapping[int, str]) -> Plan:
    cells = _cells(layout)
    cell, facing = np.divmod(np.arange(4 * len(cells)), 4)
    goals = [k for k, (row, column) in enumerate(cells) if layout[row][column] == "+"]
    return Plan(cells, [Piece("robot", "robot", cell, facing)], goals, labels)


def _cells(layout: Sequence[str]) -> list[tuple[int, int]]:
    """Return (row, column) of the free cells."""
    return [
        (row, column)
        for row, line in enumerate(layout)
        for column, mark in enumerate(line)
        if mark != " "
    ]


def _moves(action: str, neighbour: Sequence[Sequence[int | None]]) -> FloatArray:
    """Return (S, S) end states of one action, the goal treated as any cell."""
    chances = np.zeros((4 * len(neighbour), 4 * len(neighbour)))
    for cell, facing in itertools.product(range(len(neighbour)), range(4)):
        row = chances[4 * cell + facing]
        if action != "forward":
            for quarters, chance in enumerate(_TURNS[action]):
                row[4 * cell + (facing + quarters) % 4] += chance
            continue
        for chance, direction, quarters in _FORWARD:
            end = neighbour[cell][(facing + direction) % 4]
            if end is not None:
                row[4 * end + (facing + quarters) % 4] += chance
        row[4 * cell + facing] += 1.0 - row.sum()  # slips and blocked moves stay
    return chances


def _relative_walls(neighbour: Sequence[Sequence[int | None]]) -> list[list[bool]]:
    """Return for each state whether there is a wall in front, right, behind, left."""
    return [
        [around[(facing + quarters) % 4] is None for quarters in range(4)]
        for around in neighbour
        for facing in range(4)
    ]


def _wall_sensors(walls: Sequence[bool]) -> FloatArray:
    """Return (16,) chances of the readings 8 front + 4 right + 2 back + 1 left."""
    chances: FloatArray = np.ones(1)
    for wall in walls:
        seen = _SEES_WALL if wall else _SEES_PHANTOM
        chances = np.kron(chances, np.array((1.0 - seen, seen)))
    return chances


def _names(n_cells: int, n_observations: int) -> Names:
    walls = tuple(f"walls-{reading:04b}" for reading in range(16))
    landmarks = tuple(f"landmark-{k}" for k in range(n_observations - 17))
    return Names(
        states=tuple(f"cell-{cell}-{facing}" for cell in range(n_cells) for facing in "NESW"),
        actions=(ACTIONS,),
        observations=((*walls, *landmarks, "goal"),),
        agents=("agent_0",),
    )
