"""Tag (Pineau, Gordon and Thrun 2003): hunt an opponent that runs away."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array

from bnprl_envs.arguments import checked_flag
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import BoolArray, FloatArray

NORTH, SOUTH, EAST, WEST, CATCH = range(5)
ACTIONS = ("North", "South", "East", "West", "Catch")

_STEP = ((0, 1), (0, -1), (1, 0), (-1, 0))  # (x, y) of north, south, east, west
_ROWS = (range(10), range(10), range(5, 8), range(5, 8), range(5, 8))  # x of row y
_CELLS = [(x, y) for y, row in enumerate(_ROWS) for x in row]
_NUMBER = {cell: k for k, cell in enumerate(_CELLS)}
_N_CELLS = len(_CELLS)
_TAGGED = _N_CELLS  # the opponent's place once it is caught
_N_PLACES = _N_CELLS + 1
_SEEN = _N_CELLS  # observation: the opponent is here


def tag(resetting: bool = False) -> TabularModel:
    """Tag: find and catch an opponent that runs away and is seen only from its own cell.

    ## Description
    Robot and opponent move on 29 cells: two rows of ten, and a block of three by three above
    their columns 5 to 7. The robot's moves are certain and it knows its cell. While the robot
    moves, the opponent stays with probability .2 and else runs: .4 along each axis away from
    the cell that the robot is leaving (.2 either way where they are level), a blocked share
    staying. It holds still while the robot tries to catch it. The state is
    `30 * robot + opponent`, where opponent 29 means tagged.

    ## Action Space
    `Discrete(5)`: 0 North, 1 South, 2 East, 3 West, 4 Catch.

    ## Observation Space
    `Discrete(31)`: 0 to 28 are the robot's cell; 29 says that the opponent is in the same cell
    (after a move); 30 is the null observation that `reset` returns.

    ## Rewards
    A move -1; Catch 10 in the opponent's cell, else -10.

    ## Starting State
    Uniform over all 841 pairs of cells, equal ones included.

    ## Episode End
    Termination on catching the opponent; truncation after 251 steps.

    ## Arguments
    `resetting=False`: with True nothing terminates, as in the published model file: the tagged
    states keep themselves, where a move still costs 1 and Catch is free. (The file does not
    restart; the keyword is the same on every benchmark.)

    ## References
    Pineau, Gordon and Thrun (2003), Point-based value iteration: an anytime algorithm for
    POMDPs, IJCAI. Four of the 841 opponent rows of a widely used file differ from the rule
    above; the rule is built.

    ## Version History
    v0: initial version.

    Args:
        resetting: the continuing form.

    Returns:
        The model: S = 870, A = 5, O = 30, discount .95.

    Raises:
        ValueError: `resetting` is neither True nor False.
    """
    checked_flag("resetting", resetting)
    tagged = np.tile(np.arange(_N_PLACES) == _TAGGED, _N_CELLS)
    return TabularModel(
        _transition(),
        _observation(),
        _reward(tagged, resetting)[:, :, None, None],
        ~tagged / _N_CELLS**2,
        discount=0.95,
        terminal=None if resetting else tagged,
        names=_names(),
    )


def tag_scene(**_: object) -> Plan:
    """Return what the cells look like; a belief is about the opponent."""
    robot, opponent = np.divmod(np.arange(_N_CELLS * _N_PLACES), _N_PLACES)
    north = max(y for _, y in _CELLS)
    return Plan(
        cells=[(north - y, x) for x, y in _CELLS],
        pieces=[
            Piece("robot", "robot", robot),
            Piece("opponent", "opponent", np.where(opponent == _TAGGED, -1, opponent), sign="O"),
        ],
        notes={int(state): "caught" for state in np.flatnonzero(opponent == _TAGGED)},
        believed=1,
    )


def _state(robot: int, opponent: int) -> int:
    return _N_PLACES * robot + opponent


def _states() -> Iterator[tuple[int, int]]:
    return ((robot, place) for robot in range(_N_CELLS) for place in range(_N_PLACES))


def _move(cell: int, direction: int) -> int:
    """Return the neighbouring cell, or the same one where the way is blocked."""
    (x, y), (dx, dy) = _CELLS[cell], _STEP[direction]
    return _NUMBER.get((x + dx, y + dy), cell)


def _flight(robot: int, opponent: int) -> dict[int, float]:
    """Return where the opponent goes, seeing the cell that the robot is leaving."""
    chances: dict[int, float] = defaultdict(float)
    chances[opponent] = 0.2
    for axis, (ahead, back) in enumerate(((EAST, WEST), (NORTH, SOUTH))):
        lead = _CELLS[opponent][axis] - _CELLS[robot][axis]
        for direction, away in ((ahead, lead > 0), (back, lead < 0)):
            chances[_move(opponent, direction)] += 0.2 if lead == 0 else 0.4 * away
    return chances


def _transition() -> csr_array:
    """Return sparse (A * S, S) end states."""
    n_states = _N_CELLS * _N_PLACES
    rows: list[int] = []
    ends: list[int] = []
    chances: list[float] = []
    for robot, opponent in _states():
        state = _state(robot, opponent)
        caught = opponent in (robot, _TAGGED)
        flight = {_TAGGED: 1.0} if opponent == _TAGGED else _flight(robot, opponent)
        for action in range(len(ACTIONS)):
            if action == CATCH:
                outcomes = {_state(robot, _TAGGED if caught else opponent): 1.0}
            else:
                place = robot if opponent == _TAGGED else _move(robot, action)
                outcomes = {_state(place, end): chance for end, chance in flight.items()}
            rows += [action * n_states + state] * len(outcomes)
            ends += outcomes.keys()
            chances += outcomes.values()
    return csr_array((chances, (rows, ends)), shape=(len(ACTIONS) * n_states, n_states))


def _observation() -> csr_array:
    """Return sparse (A * S, O) observations: each is certain."""
    seen = [
        _SEEN if action != CATCH and robot == opponent else robot
        for action in range(len(ACTIONS))
        for robot, opponent in _states()
    ]
    return csr_array(
        (np.ones(len(seen)), seen, np.arange(len(seen) + 1)), shape=(len(seen), _N_CELLS + 1)
    )


def _reward(tagged: BoolArray, resetting: bool) -> FloatArray:
    """Return (A, S) rewards."""
    reward = np.full((len(ACTIONS), tagged.size), -1.0)
    reward[CATCH] = [10.0 if robot == opponent else -10.0 for robot, opponent in _states()]
    reward[CATCH, tagged] = 0.0
    if not resetting:
        reward[:, tagged] = 0.0
    return reward


def _names() -> Names:
    places = (*(f"opponent-{cell}" for cell in range(_N_CELLS)), "tagged")
    return Names(
        states=tuple(f"robot-{robot}-{places[place]}" for robot, place in _states()),
        actions=(ACTIONS,),
        observations=((*(f"robot-{cell}" for cell in range(_N_CELLS)), "opponent-here"),),
        agents=("agent_0",),
    )
