"""Mars rovers (Amato and Zilberstein 2009): two rovers, some of whose sites need both."""

from __future__ import annotations

import itertools

import numpy as np

from bnprl_envs.benchmarks.teams import independent, team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.plan import Piece, Plan
from bnprl_envs.tables import FloatArray

UP, DOWN, LEFT, RIGHT, DRILL, SAMPLE = range(6)
ACTIONS = ("up", "down", "left", "right", "drill", "sample")

_STEP = ((-1, 0), (1, 0), (0, -1), (0, 1))  # (row, column) of each move
_SITES = ((0, 0), (1, 0), (0, 1), (1, 1))  # (row, column)
_SUCCESS = 0.9
_ALL_DONE = 0b1111
_TOGETHER = {  # both rovers use the same tool at the same fresh site: reward at each site
    DRILL: (6.0, 0.0, 0.0, 6.0),
    SAMPLE: (1.0, 2.0, 2.0, 1.0),
}
_APART = {  # at different sites, by the first rover's tool: reward for 0, 1, 2 fresh ones
    DRILL: (-2.0, -11.0, 0.0),
    SAMPLE: (-2.0, 1.0, 4.0),
}
_ALONE = {DRILL: -10.0, SAMPLE: 2.0}  # one rover at a fresh site
_MOVE, _DONE = -0.1, -1.0  # a move; a tool at a site that is done


def mars_rovers() -> TabularModel:
    """Mars rovers: two rovers experiment at four sites, at two of them best with both drills.

    ## Description
    The sites are the cells of a grid of two rows; 0 is upper left, 1 lower left, 2 upper right, 3
    lower right. A move succeeds with probability .9; a way off the grid is a stay. Either tool,
    used by either rover, finishes the site; once all four are done, rovers and sites begin anew,
    whatever the other rover did. The state is `64 * first + 16 * second + done`, where bit k of
    `done` says that site k is finished.

    ## Action Space
    `Discrete(6)` each: 0 up, 1 down, 2 left, 3 right, 4 drill, 5 sample.

    ## Observation Space
    `Discrete(9)` each: the rover's own site, plus 4 if it is finished; 8 is the null observation
    that `reset` returns.

    ## Rewards
    A move costs .1, a tool at a finished site 1. One rover alone at a fresh site earns 2 for a
    sample and -10 for drilling; these add up unless both use a tool. Both at the same fresh site:
    both drilling earns 6 at sites 0 and 3, and nothing at 1 and 2; both sampling 1 at sites 0
    and 3, 2 at 1 and 2; one of each nothing. Both at different sites: as in the published tables
    only the first rover's tool counts; sampling earns 4 if both sites are fresh and 1 if one is;
    drilling 0 and -11; and -2 if both are finished.

    ## Starting State
    Both rovers at site 0, nothing finished.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Amato and Zilberstein (2009), Achieving goals in decentralized POMDPs, AAMAS.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 256 (the 16 with all sites finished are never reached), A = 6 x 6,
        O = 8 x 8, discount .9.
    """
    return TabularModel(
        _transition(),
        np.tile(_observation(), (36, 1, 1)),
        _rewards()[:, :, None, None],
        np.eye(256)[0],
        discount=0.9,
        action_sizes=(6, 6),
        observation_sizes=(8, 8),
        names=team_names(
            [f"sites-{first}-{second}-done-{done:04b}" for first, second, done in _states()],
            ACTIONS,
            [f"site-{site}-{mark}" for mark in ("fresh", "done") for site in range(4)],
        ),
    )


def mars_rovers_scene() -> Plan:
    """Return what the sites look like."""
    first, second, done = np.array(_states()).T
    return Plan(
        cells=_SITES,
        pieces=[
            Piece("agent_0", "robot", first, sign="0"),
            Piece("agent_1", "robot", second, sign="1", agent=1),
        ],
        labels={0: "drill together", 1: "sample", 2: "sample", 3: "drill together"},
        done=(done[:, None] >> np.arange(len(_SITES)) & 1).astype(np.bool_),
    )


def _states() -> list[tuple[int, int, int]]:
    """Return (first rover's site, second rover's site, done) of every state."""
    return list(itertools.product(range(4), range(4), range(16)))


def _joint_actions() -> list[tuple[int, int]]:
    return list(itertools.product(range(6), range(6)))


def _motion() -> FloatArray:
    """Return (6, 4, 4) end sites of one rover."""
    chances = np.zeros((6, 4, 4))
    chances[[DRILL, SAMPLE]] = np.eye(4)
    for action, (row, column) in enumerate(_STEP):
        for site, (r, c) in enumerate(_SITES):
            end = (r + row, c + column)
            if end in _SITES:
                chances[action, site, _SITES.index(end)] = _SUCCESS
            chances[action, site, site] = 1.0 - chances[action, site].sum()
    return chances


def _finish(sites: tuple[int, int], done: int, actions: tuple[int, int]) -> int:
    """Return which sites are done after the tools were used."""
    for site, action in zip(sites, actions, strict=True):
        if action in _ALONE:
            done |= 1 << site
    return done


def _transition() -> FloatArray:
    """Return (A, S, S) end states."""
    motion = independent(_motion(), _motion())
    chances = np.zeros((36, 256, 16, 16))  # of (sites, done)
    for joint, actions in enumerate(_joint_actions()):
        for state, (first, second, done) in enumerate(_states()):
            after = _finish((first, second), done, actions)
            if after == _ALL_DONE and set(actions) & set(_ALONE):
                chances[joint, state, 0, 0] = 1.0
            else:
                chances[joint, state, :, after] = motion[joint, 4 * first + second]
    return chances.reshape(36, 256, 256)


def _observation() -> FloatArray:
    """Return (S', O) observations, which are certain."""
    seen = [
        [site + 4 * (done >> site & 1) for site in (first, second)]
        for first, second, done in _states()
    ]
    return np.eye(64)[[8 * first + second for first, second in seen]]


def _rewards() -> FloatArray:
    """Return (A, S) rewards."""
    return np.array(
        [
            [_reward((first, second), done, actions) for first, second, done in _states()]
            for actions in _joint_actions()
        ]
    )


def _reward(sites: tuple[int, int], done: int, actions: tuple[int, int]) -> float:
    """Return what a joint action earns."""
    fresh = [not done >> site & 1 for site in sites]
    if all(action in _ALONE for action in actions):
        if sites[0] != sites[1]:
            return _APART[actions[0]][sum(fresh)]
        if fresh[0]:
            return _TOGETHER[actions[0]][sites[0]] if actions[0] == actions[1] else 0.0
    return sum(
        _MOVE if action not in _ALONE else _ALONE[action] if new else _DONE
        for action, new in zip(actions, fresh, strict=True)
    )
