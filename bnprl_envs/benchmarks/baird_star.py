"""Baird's star (Baird 1995): seven states on which linear Q-learning diverges."""

from __future__ import annotations

import numpy as np

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.graph import Edge, Graph
from bnprl_envs.tables import FloatArray

SOLID, DASHED = range(2)
ACTIONS = ("solid", "dashed")

_N_STATES = 7
_CENTRE = _N_STATES - 1


def baird_star() -> TabularModel:
    """Baird's star: all rewards are 0, and Q-learning on its classical features diverges.

    ## Description
    Six outer states, 0 to 5, and a centre, 6. The solid action leads to the centre, the dashed
    one to an outer state, each with probability 1/6, from wherever the agent is. Every policy is
    worth 0: the problem tests whether a learner with function approximation finds that out. With
    the features of `star_features`, the weights of `star_initial_weights` and a behaviour that
    takes the dashed action with probability 6/7 (so that all states are visited alike), the
    weights of semi-gradient Q-learning grow without bound.

    ## Action Space
    `Discrete(2)`: 0 solid, 1 dashed.

    ## Observation Space
    `Discrete(7)`: the state.

    ## Rewards
    Always 0.

    ## Starting State
    Uniform over the seven states.

    ## Episode End
    Never terminates; truncation after 1000 steps.

    ## Arguments
    None.

    ## References
    Baird (1995), Residual algorithms: reinforcement learning with function approximation, ICML.
    Sutton and Barto (2018), Reinforcement Learning, second edition, example 11.1 (the seven
    states, the dynamics, the discount and the state features used here). Maei, Szepesvari,
    Bhatnagar and Sutton (2010), Toward off-policy learning control with function approximation,
    ICML (the star with action values).

    ## Version History
    v0: initial version.

    Returns:
        The model, fully observed: S = 7, A = 2, discount .99.
    """
    outer = np.arange(_N_STATES) != _CENTRE
    ends = np.stack([~outer, outer / outer.sum()])
    states = (*(f"outer-{k}" for k in range(_CENTRE)), "centre")
    return TabularModel(
        np.repeat(ends[:, None], _N_STATES, axis=1),
        None,
        0.0,
        np.full(_N_STATES, 1 / _N_STATES),
        discount=0.99,
        names=Names(states, (ACTIONS,), (states,), ("agent_0",)),
    )


def baird_star_scene() -> Graph:
    """Return what the star looks like."""
    angles = np.pi * (0.5 - np.arange(_CENTRE) / 3)
    rays = [(float(np.cos(angle)), float(np.sin(angle))) for angle in angles]
    solid = [Edge(outer, _CENTRE, SOLID, 0.12) for outer in range(_CENTRE)]
    dashed = [Edge(_CENTRE, outer, DASHED, 0.12) for outer in range(_CENTRE)]
    return Graph(
        positions=[*rays, (0.0, 0.0)],
        labels=[str(state) for state in range(_N_STATES)],
        edges=solid + dashed,
        actions=ACTIONS,
    )


def star_features() -> FloatArray:
    """Return the fixed bases (S, A, 15) with which Q-learning diverges.

    The solid action has the eight state features of the star, 2 w_s + w_7 outside and
    w_6 + 2 w_7 in the centre; the dashed action has an entry of its own for each state, w_{8+s}.
    """
    features = np.zeros((_N_STATES, len(ACTIONS), 2 * _N_STATES + 1))
    state = np.arange(_N_STATES)
    features[state, SOLID, state] = np.where(state == _CENTRE, 1.0, 2.0)
    features[:, SOLID, _N_STATES] = np.where(state == _CENTRE, 2.0, 1.0)
    features[state, DASHED, _N_STATES + 1 + state] = 1.0
    return features


def star_initial_weights() -> FloatArray:
    """Return the customary first weights (15,): 1, but 10 for the centre's own (w_6)."""
    weights = np.ones(2 * _N_STATES + 1)
    weights[_CENTRE] = 10.0
    return weights
