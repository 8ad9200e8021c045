"""Shuttle (Chrisman 1992): carry supplies between two space stations that look alike."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

TURN_AROUND, GO_FORWARD, BACK_UP = range(3)
ACTIONS = ("turn-around", "go-forward", "back-up")

_STATES = (
    "docked-lrv",
    "at-mrv-facing-mrv",
    "in-space-facing-mrv",
    "at-lrv-facing-mrv",
    "at-mrv-facing-lrv",
    "in-space-facing-lrv",
    "at-lrv-facing-lrv",
    "docked-mrv",
)
_SIGHTS = ("lrv", "mrv", "docked-mrv", "nothing", "docked-lrv")
_SEES_STATION = 0.7  # chance of seeing a station from afar

_LRV, _SPACE, _MRV = range(3)  # where the shuttle is
_PLACE = {  # state -> place, and the direction faced (1: the MRV, -1: the LRV)
    1: (_MRV, 1),
    2: (_SPACE, 1),
    3: (_LRV, 1),
    4: (_MRV, -1),
    5: (_SPACE, -1),
    6: (_LRV, -1),
}
_STATE = {place: state for state, place in _PLACE.items()}
_DOCK = {_LRV: 0, _MRV: 7}
_LEAVING = (1, 4, 7)  # from either dock, which is the MRV's from then on: the end by action


def shuttle() -> TabularModel:
    """Shuttle: dock backwards at the least recently visited of two stations, for ever.

    ## Description
    Two space stations with space between them, known to the shuttle as the least and the most
    recently visited one (LRV, MRV). It is docked, or in one of three places facing one of two
    ways: eight states. Turning and flying are certain; backing up is not. At a station with its
    back to it the shuttle docks with probability .7; facing it, it gets back into space with .3
    and turns around with .3; in space it gets one place back with .8, and turns around in doing
    so with .1 more. Where nothing of this happens, it stays. Leaving a dock makes that station
    the MRV.

    ## Action Space
    `Discrete(3)`: 0 turn around, 1 go forward, 2 back up.

    ## Observation Space
    `Discrete(6)`: 0 the LRV ahead, 1 the MRV ahead, 2 docked at the MRV, 3 nothing, 4 docked at
    the LRV; 5 is the null observation that `reset` returns. A station ahead is seen for certain
    when near, with probability .7 from space.

    ## Rewards
    Docking at the LRV 10, going forward into a station -3, else 0.

    ## Starting State
    Docked at the MRV.

    ## Episode End
    Never terminates; truncation after 251 steps.

    ## Arguments
    None.

    ## References
    Chrisman (1992), Reinforcement learning with perceptual aliasing: the perceptual distinctions
    approach, AAAI.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 8, A = 3, O = 5, discount .95.
    """
    transition = np.zeros((len(ACTIONS), len(_STATES), len(_STATES)))
    for action in range(len(ACTIONS)):
        transition[action, list(_DOCK.values()), _LEAVING[action]] = 1.0
        for state in _PLACE:
            for chance, end in _outcomes(action, state):
                transition[action, state, end] += chance
    reward = np.zeros((*transition.shape, 1))
    for station, facing in ((_LRV, -1), (_MRV, 1)):
        crash = _STATE[station, facing]
        reward[GO_FORWARD, crash, crash] = -3.0
    reward[BACK_UP, _STATE[_LRV, 1], _DOCK[_LRV]] = 10.0
    return TabularModel(
        transition,
        [_observation()] * len(ACTIONS),
        reward,
        np.eye(len(_STATES))[_DOCK[_MRV]],
        discount=0.95,
        names=Names(_STATES, (ACTIONS,), (_SIGHTS,), ("agent_0",)),
    )


def shuttle_scene() -> Plan:
    """Return what the way between the stations looks like; a docked shuttle faces space."""
    where = {_DOCK[_LRV]: (0, 1), _DOCK[_MRV]: (4, -1)}
    where |= {state: (1 + place, facing) for state, (place, facing) in _PLACE.items()}
    places, facing = np.array([where[state] for state in range(len(_STATES))]).T
    return Plan(
        cells=[(0, column) for column in range(5)],
        pieces=[Piece("shuttle", "robot", places, np.where(facing > 0, 1, 3), sign="S")],
        goals=[0],
        labels={0: "dock LRV", 1: "at LRV", 2: "space", 3: "at MRV", 4: "dock MRV"},
    )


def _outcomes(action: int, state: int) -> Iterator[tuple[float, int]]:
    """Yield the ends of an action outside the docks, with their chances."""
    place, facing = _PLACE[state]
    turned = _STATE[place, -facing]
    if action == TURN_AROUND:
        yield 1.0, turned
    elif action == GO_FORWARD:
        yield 1.0, _STATE.get((place + facing, facing), state)
    elif place == _SPACE:
        yield from (
            (0.8, _STATE[place - facing, facing]),
            (0.1, _STATE[place - facing, -facing]),
            (0.1, state),
        )
    elif (place + facing, facing) in _STATE:  # at a station, with its back to it
        yield from ((0.7, _DOCK[place]), (0.3, state))
    else:
        yield from ((0.3, _STATE[_SPACE, facing]), (0.3, turned), (0.4, state))


def _observation() -> FloatArray:
    """Return what is seen in each state (S, O)."""
    ahead = {1: _SIGHTS.index("mrv"), -1: _SIGHTS.index("lrv")}
    nothing = _SIGHTS.index("nothing")
    seen = np.zeros((len(_STATES), len(_SIGHTS)))
    for state, (place, facing) in _PLACE.items():
        nearby = place + facing not in (_LRV, _SPACE, _MRV)
        chance = 1.0 if nearby else _SEES_STATION if place == _SPACE else 0.0
        seen[state, ahead[facing]] = chance
        seen[state, nothing] += 1.0 - chance
    seen[_DOCK[_LRV], _SIGHTS.index("docked-lrv")] = 1.0
    seen[_DOCK[_MRV], _SIGHTS.index("docked-mrv")] = 1.0
    return seen
