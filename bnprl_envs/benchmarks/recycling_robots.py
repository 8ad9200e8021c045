"""Recycling robots (Amato, Bernstein and Zilberstein 2007): a big can takes two robots."""

from __future__ import annotations

import itertools

import numpy as np

from bnprl_envs.benchmarks.teams import independent, team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.gauges import Gauges
from bnprl_envs.tables import FloatArray

RECHARGE, LITTLE, BIG = range(3)
HIGH, LOW = range(2)

_ENDS_LOW = np.array(  # (action, battery): chance that the battery is low afterwards
    [
        [0.0, 0.0],
        [0.3, 0.8],
        [0.5, 0.7],
    ]
)


def recycling_robots() -> TabularModel:
    """Recycling robots: collect cans together without running out of battery.

    ## Description
    Each robot has a battery that is high or low. Looking for a little can leaves a high battery
    low with probability .3 and empties a low one with .2; looking for the big can, .5 and .3. An
    emptied robot is carried home and charged, which is expensive. The state is
    `2 * first + second` of the batteries (0 high, 1 low), which are independent.

    ## Action Space
    `Discrete(3)` each: 0 recharge, 1 look for a little can, 2 look for the big can. (The labels
    in the published file name them in another order; this is what its tables do.)

    ## Observation Space
    `Discrete(3)` each: 0 and 1 are the robot's own battery, high and low; 2 is the null
    observation that `reset` returns.

    ## Rewards
    The expectation, given state and actions, of: unless a battery is emptied, 2 for each robot
    that looks for a little can, and 5 if both look for the big one; -10 for each emptied battery.

    ## Starting State
    Both batteries are high.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Amato, Bernstein and Zilberstein (2007), Optimizing memory-bounded controllers for
    decentralized POMDPs, UAI.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 4, A = 3 x 3, O = 2 x 2, discount .9.
    """
    battery = np.stack([1.0 - _ENDS_LOW, _ENDS_LOW], axis=2)
    levels = ("high", "low")
    return TabularModel(
        independent(battery, battery),
        np.tile(np.eye(4), (9, 1, 1)),
        _reward()[:, :, None, None],
        [1.0, 0.0, 0.0, 0.0],
        discount=0.9,
        action_sizes=(3, 3),
        observation_sizes=(2, 2),
        names=team_names(
            [f"{first}-{second}" for first in levels for second in levels],
            ("recharge", "little-can", "big-can"),
            levels,
        ),
    )


def recycling_robots_scene() -> Gauges:
    """Return what the batteries look like."""
    battery = np.stack(np.divmod(np.arange(4), 2), axis=1)
    levels, words = np.array([1.0, 0.25]), np.array(["high", "low"])
    return Gauges("battery", levels[battery], words[battery])


def _reward() -> FloatArray:
    """Return (A, S) rewards."""
    emptied = (1.0 - _ENDS_LOW) * ([[False, False], [False, True], [False, True]])
    reward = np.empty((3, 3, 2, 2))
    for *actions, first, second in itertools.product(range(3), range(3), range(2), range(2)):
        chances = np.array([emptied[actions[0], first], emptied[actions[1], second]])
        cans = 2.0 * actions.count(LITTLE) + 5.0 * (actions.count(BIG) == 2)
        reward[*actions, first, second] = np.prod(1.0 - chances) * cans - 10.0 * chances.sum()
    return reward.reshape(9, 4)
