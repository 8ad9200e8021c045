"""Tiger (Kaelbling, Littman and Cassandra 1998): listen before you open a door."""

from __future__ import annotations

import numpy as np

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.doors import Doors

LISTEN, OPEN_LEFT, OPEN_RIGHT = range(3)

_HEARS = 0.85  # chance of hearing the tiger where it is


def tiger() -> TabularModel:
    """Tiger: find out by listening which of two doors hides a tiger, and open the other.

    ## Description
    A tiger waits behind the left or the right door. Listening tells where, correctly with
    probability .85, and changes nothing; opening a door places the tiger anew, behind either
    door alike, and tells nothing.

    ## Action Space
    `Discrete(3)`: 0 listen, 1 open left, 2 open right.

    ## Observation Space
    `Discrete(3)`: 0 the tiger is heard on the left, 1 on the right; 2 is the null observation
    that `reset` returns.

    ## Rewards
    Listening -1, the tiger's door -100, the other door 10.

    ## Starting State
    The tiger is behind either door alike.

    ## Episode End
    Never terminates; truncation after 251 steps.

    ## Arguments
    None.

    ## References
    Kaelbling, Littman and Cassandra (1998), Planning and acting in partially observable
    stochastic domains, Artificial Intelligence 101.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 2, A = 3, O = 2, discount .95.
    """
    anew = np.full((2, 2), 0.5)
    heard = np.array([[_HEARS, 1.0 - _HEARS], [1.0 - _HEARS, _HEARS]])
    places = ("tiger-left", "tiger-right")
    return TabularModel(
        np.stack([np.eye(2), anew, anew]),
        np.stack([heard, anew, anew]),
        np.array([[-1.0, -1.0], [-100.0, 10.0], [10.0, -100.0]])[:, :, None, None],
        [0.5, 0.5],
        discount=0.95,
        names=Names(places, (("listen", "open-left", "open-right"),), (places,), ("agent_0",)),
    )


def tiger_scene() -> Doors:
    """Return what the doors look like."""
    return Doors(opens=(OPEN_LEFT, OPEN_RIGHT))
