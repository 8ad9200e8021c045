"""Dec-Tiger (Nair et al. 2003): two listeners must open the same door without speaking."""

from __future__ import annotations

import numpy as np

from bnprl_envs.benchmarks.teams import team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.doors import Doors
from bnprl_envs.tables import FloatArray

LISTEN, OPEN_LEFT, OPEN_RIGHT = range(3)

_HEARS = 0.85  # chance of hearing the tiger where it is
_REWARDS = np.array(  # of what the two agents do: listen, open the tiger's door, open the other
    [
        [-2.0, -101.0, 9.0],
        [-101.0, -50.0, -100.0],
        [9.0, -100.0, 20.0],
    ]
)
_DOINGS = ((0, 1, 2), (0, 2, 1))  # of the three actions, for each place of the tiger


def dec_tiger() -> TabularModel:
    """Dec-Tiger: two agents listen for a tiger and should then open the other door together.

    ## Description
    A tiger waits behind the left or the right door. While both agents listen it stays, and each
    hears it where it is with probability .85, independently of the other. Any other joint action
    places it anew, behind either door alike, and tells nothing. The agents cannot speak, so one
    never knows what the other heard.

    ## Action Space
    `Discrete(3)` each: 0 listen, 1 open left, 2 open right.

    ## Observation Space
    `Discrete(3)` each: 0 the tiger is heard on the left, 1 on the right; 2 is the null
    observation that `reset` returns.

    ## Rewards
    Of the team: both listen -2; both open the tiger's door -50; both open the other door 20; they
    open different doors -100; one listens and the other opens the tiger's door -101, the other
    door 9.

    ## Starting State
    The tiger is behind either door alike.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Nair, Tambe, Yokoo, Pynadath and Marsella (2003), Taming decentralized POMDPs: towards
    efficient policy computation for multiagent settings, IJCAI.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 2, A = 3 x 3, O = 2 x 2, discount .9.
    """
    anew = np.full((2, 2), 0.5)
    quiet = np.full((2, 4), 0.25)
    places = ("tiger-left", "tiger-right")
    return TabularModel(
        [np.eye(2), *[anew] * 8],
        [_hearing(), *[quiet] * 8],
        _reward()[:, :, None, None],
        [0.5, 0.5],
        discount=0.9,
        action_sizes=(3, 3),
        observation_sizes=(2, 2),
        names=team_names(places, ("listen", "open-left", "open-right"), places),
    )


def dec_tiger_scene() -> Doors:
    """Return what the doors look like."""
    return Doors(opens=(OPEN_LEFT, OPEN_RIGHT))


def _hearing() -> FloatArray:
    """Return (S, O) chances of what two listeners hear."""
    one = np.array([[_HEARS, 1.0 - _HEARS], [1.0 - _HEARS, _HEARS]])
    both: FloatArray = np.einsum("so,sp->sop", one, one)
    return both.reshape(2, 4)


def _reward() -> FloatArray:
    """Return (A, S) rewards."""
    return np.stack([_REWARDS[np.ix_(doing, doing)].ravel() for doing in _DOINGS], axis=1)
