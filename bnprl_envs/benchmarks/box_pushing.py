"""Cooperative box pushing (Seuken and Zilberstein 2007): the large box takes two robots."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from bnprl_envs.benchmarks.teams import team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

TURN_LEFT, TURN_RIGHT, FORWARD, STAY = range(4)
EMPTY, WALL, OTHER, SMALL_BOX, LARGE_BOX = range(5)
LEFT_AT_GOAL, RIGHT_AT_GOAL, BOTH_AT_GOAL, LARGE_AT_GOAL = range(4)

_NORTH, _EAST, _SOUTH, _WEST = range(4)
_TURNS = {TURN_LEFT: -1, TURN_RIGHT: 1}
_WAYS = {_EAST: 1, _WEST: -1}  # columns of a step
_COLUMNS = range(1, 5)
_SUCCESS = 0.9
_MOVED = (  # goals at which the left, the large, the right box has been moved
    (LEFT_AT_GOAL, BOTH_AT_GOAL),
    (LARGE_AT_GOAL,),
    (RIGHT_AT_GOAL, BOTH_AT_GOAL),
)
_GOALS = ("left-at-goal", "right-at-goal", "both-at-goal", "large-at-goal")


class Robot(NamedTuple):
    """Where a robot is, 1 to 4 from the left, and which way it faces."""

    column: int
    facing: int


Team = tuple[Robot, Robot]
Actions = tuple[int, int]


_TEAMS: list[Team] = [
    (Robot(first, one), Robot(second, other))
    for first in range(1, 4)
    for one in range(4)
    for second in range(first + 1, 5)
    for other in range(4)
]
_NUMBER = {team: len(_GOALS) + k for k, team in enumerate(_TEAMS)}
_START = _NUMBER[(Robot(1, _EAST), Robot(4, _WEST))]


def box_pushing() -> TabularModel:
    """Box pushing: two robots push a small box each, or better the large box together.

    ## Description
    The robots stand in the lower row of a grid of four columns. North of columns 1 and 4 is a
    small box each, north of 2 and 3 the large one. Each robot's turn or step succeeds with
    probability .9, else it does nothing. A small box that is pushed, or the large one that both
    push at once, is at its goal, and everything begins again with the next step. Robots do not
    pass each other, and if both would enter one cell neither moves. States 0 to 3 are boxes at
    the goal (left, right, both small, large); then come the 96 pairs of robots, the left one
    first, by (column, orientation) of each, orientations in the order north, east, south, west.

    ## Action Space
    `Discrete(4)` each: 0 turn left, 1 turn right, 2 forward, 3 stay.

    ## Observation Space
    `Discrete(6)` each: what the robot faces, 0 an empty cell, 1 the wall, 2 the other robot, 3 a
    small box, 4 the large box; at a goal both see 0. 5 is the null observation that `reset`
    returns.

    ## Rewards
    For what is tried, successful or not: -.2 a step; 10 for each push of a small box; 100 for a
    push of the large box by both; -5 for each robot that moves into the wall, into the other
    robot, against the large box alone, or into the same cell as the other. 0 at a goal.

    ## Starting State
    The robots stand in the outer columns and face each other.

    ## Episode End
    Never terminates: after a goal the boxes and robots are put back. Truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Seuken and Zilberstein (2007), Improved memory-bounded dynamic programming for decentralized
    POMDPs, UAI. One row of a widely used file departs from the rule above (both forward, the
    left robot in column 2 facing east, the right one in column 4 facing west); the rule is built.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 100, A = 4 x 4, O = 5 x 5, discount .9.
    """
    n_states = len(_GOALS) + len(_TEAMS)
    return TabularModel(
        np.stack([_transition(actions) for actions in _joint_actions()]),
        np.tile(_observation(), (16, 1, 1)),
        _rewards()[:, :, None, None],
        np.eye(n_states)[_START],
        discount=0.9,
        action_sizes=(4, 4),
        observation_sizes=(5, 5),
        names=team_names(
            [*_GOALS, *map(_name, _TEAMS)],
            ("turn-left", "turn-right", "forward", "stay"),
            ("empty", "wall", "other-robot", "small-box", "large-box"),
        ),
    )


def box_pushing_scene() -> Plan:
    """Return what the room looks like: the goal in the north, then the boxes, then the robots."""
    robots = np.array([[(-1, 0)] * 2] * len(_GOALS) + _TEAMS)  # (S, 2, 2); at a goal nowhere
    columns, facing = robots[:, :, 0], robots[:, :, 1]
    places = np.where(columns < 0, -1, 8 + columns - 1)
    state = np.arange(len(robots))
    moved = [np.isin(state, goals) for goals in _MOVED]
    return Plan(
        cells=[(row, column) for row in range(3) for column in range(4)],
        pieces=[
            Piece("small box", "box", np.where(moved[0], 0, 4), sign="b"),
            Piece("large box", "box", np.where(moved[1], 1, 5), sign="B", span=2),
            Piece("small box", "box", np.where(moved[2], 3, 7), sign="b"),
            Piece("agent_0", "robot", places[:, 0], facing[:, 0], sign="0"),
            Piece("agent_1", "robot", places[:, 1], facing[:, 1], sign="1", agent=1),
        ],
        goals=range(4),
        notes={goal: f"{name.replace('-', ' ')}; begins anew" for goal, name in enumerate(_GOALS)},
        believed=3,
    )


def _name(team: Team) -> str:
    """Return for example "s1E4W"."""
    return "s" + "".join(f"{robot.column}{'NESW'[robot.facing]}" for robot in team)


def _joint_actions() -> list[Actions]:
    return [(first, second) for first in range(4) for second in range(4)]


def _ahead(robot: Robot) -> int:
    """Return the column that the robot faces, its own if north or south."""
    return robot.column + _WAYS.get(robot.facing, 0)


def _faces(team: Team) -> tuple[int, int]:
    """Return what each robot faces."""
    first, second = team
    return _faced(first, second), _faced(second, first)


def _faced(robot: Robot, other: Robot) -> int:
    if robot.facing == _NORTH:
        return SMALL_BOX if robot.column in (1, 4) else LARGE_BOX
    if robot.facing == _SOUTH or _ahead(robot) not in _COLUMNS:
        return WALL
    return OTHER if _ahead(robot) == other.column else EMPTY


def _clash(team: Team, actions: Actions) -> bool:
    """Return whether both robots try to enter the same empty cell."""
    return (
        actions == (FORWARD, FORWARD)
        and _faces(team) == (EMPTY, EMPTY)
        and (_ahead(team[0]) == _ahead(team[1]))
    )


def _end(team: Team, actions: Actions) -> int:
    """Return the end state of actions that succeed."""
    faces = _faces(team)
    forward = [action == FORWARD for action in actions]
    left, right = (forward[k] and faces[k] == SMALL_BOX for k in range(2))
    if left or right:  # the robots keep their order: in column 1 is the first, in 4 the second
        return BOTH_AT_GOAL if left and right else LEFT_AT_GOAL if left else RIGHT_AT_GOAL
    if all(forward) and faces == (LARGE_BOX, LARGE_BOX):
        return LARGE_AT_GOAL
    if _clash(team, actions):
        return _NUMBER[team]
    first, second = (_moved(*each) for each in zip(team, actions, faces, strict=True))
    return _NUMBER[first, second]


def _moved(robot: Robot, action: int, faced: int) -> Robot:
    """Return one robot after its action, which nobody else disturbs."""
    if action in _TURNS:
        return robot._replace(facing=(robot.facing + _TURNS[action]) % 4)
    return robot._replace(column=_ahead(robot)) if action == FORWARD and faced == EMPTY else robot


def _transition(actions: Actions) -> FloatArray:
    """Return (S, S) end states of a joint action."""
    chances = np.zeros((len(_GOALS) + len(_TEAMS),) * 2)
    chances[: len(_GOALS), _START] = 1.0
    for team, successes in itertools.product(_TEAMS, itertools.product((True, False), repeat=2)):
        first, second = (
            action if success else STAY for action, success in zip(actions, successes, strict=True)
        )
        chance = np.prod([_SUCCESS if success else 1.0 - _SUCCESS for success in successes])
        chances[_NUMBER[team], _end(team, (first, second))] += chance
    return chances


def _observation() -> FloatArray:
    """Return (S', O) observations, which are certain."""
    seen = [(EMPTY, EMPTY)] * len(_GOALS) + [_faces(team) for team in _TEAMS]
    return np.eye(25)[[5 * first + second for first, second in seen]]


def _rewards() -> FloatArray:
    """Return (A, S) rewards."""
    return np.array(
        [
            [0.0] * len(_GOALS) + [_reward(team, actions) for team in _TEAMS]
            for actions in _joint_actions()
        ]
    )


def _reward(team: Team, actions: Actions) -> float:
    """Return what a joint attempt earns."""
    pushed = [
        faced for faced, action in zip(_faces(team), actions, strict=True) if action == FORWARD
    ]
    together = pushed.count(LARGE_BOX) == 2
    bumps = pushed.count(WALL) + pushed.count(OTHER) + 2 * _clash(team, actions)
    if not together:
        bumps += pushed.count(LARGE_BOX)
    return -0.2 + 10.0 * pushed.count(SMALL_BOX) + 100.0 * together - 5.0 * bumps
