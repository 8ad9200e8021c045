"""Broadcast channel (Ooi and Wornell 1996): two senders share a line that carries one message."""

from __future__ import annotations

import itertools

import numpy as np

from bnprl_envs.benchmarks.teams import independent, team_names
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.gauges import Gauges
from bnprl_envs.tables import FloatArray

SEND, WAIT = range(2)
COLLISION, NO_COLLISION = range(2)

_ARRIVAL = (0.9, 0.1)  # chance that a message comes to an empty buffer, for each agent
_HEARS = 0.9  # chance of hearing rightly whether there was a collision


def broadcast_channel() -> TabularModel:
    """Broadcast channel: get as many messages as possible through a line that carries one a step.

    ## Description
    Each agent has a buffer for one message. An agent that waits keeps its message; sending clears
    the buffer even if the messages collide, and an empty buffer, or one just cleared, receives a
    new message with probability .9 (first agent) or .1 (second). The state is `2 * a + b`, where
    a and b say whether the first and the second agent have a message.

    ## Action Space
    `Discrete(2)` each: 0 send, 1 wait.

    ## Observation Space
    `Discrete(3)` each: 0 collision, 1 no collision, each agent's own report, which is right with
    probability .9 (a collision is two agents sending, whatever their buffers hold); 2 is the null
    observation that `reset` returns.

    ## Rewards
    1 if exactly one agent sends and it has a message, else 0.

    ## Starting State
    Both agents have a message.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    None.

    ## References
    Ooi and Wornell (1996), Decentralized control of a multiple access broadcast channel:
    performance bounds, CDC. Hansen, Bernstein and Zilberstein (2004), Dynamic programming for
    partially observable stochastic games, AAAI.

    ## Version History
    v0: initial version.

    Returns:
        The model: S = 4, A = 2 x 2, O = 2 x 2, discount .9.
    """
    first, second = (_buffer(arrival) for arrival in _ARRIVAL)
    return TabularModel(
        independent(first, second),
        _observation(),
        _reward()[:, :, None, None],
        [0.0, 0.0, 0.0, 1.0],
        discount=0.9,
        action_sizes=(2, 2),
        observation_sizes=(2, 2),
        names=team_names(
            [f"messages-{a}{b}" for a in range(2) for b in range(2)],
            ("send", "wait"),
            ("collision", "no-collision"),
        ),
    )


def broadcast_channel_scene() -> Gauges:
    """Return what the buffers and the line between the senders look like."""
    full = np.stack(np.divmod(np.arange(4), 2), axis=1)
    return Gauges(
        "buffer",
        levels=full.astype(np.float64),
        words=np.array(["empty", "message"])[full],
        links={
            (SEND, SEND): "collision!",
            (SEND, WAIT): "agent_0 sends",
            (WAIT, SEND): "agent_1 sends",
            (WAIT, WAIT): "",
        },
    )


def _buffer(arrival: float) -> FloatArray:
    """Return (2, 2, 2) chances that one agent has a message after an action."""
    chances = np.full((2, 2, 2), (1.0 - arrival, arrival))
    chances[WAIT, 1] = (0.0, 1.0)
    return chances


def _observation() -> FloatArray:
    """Return (A, S', O) reports; they depend on the actions alone."""
    collided, clear = np.array([_HEARS, 1.0 - _HEARS]), np.array([1.0 - _HEARS, _HEARS])
    reports = np.stack([np.kron(one, one) for one in (collided, clear, clear, clear)])
    return np.repeat(reports[:, None], 4, axis=1)


def _reward() -> FloatArray:
    """Return (A, S) rewards."""
    pairs = list(itertools.product(range(2), repeat=2))
    return np.array(
        [
            [first != second and messages[0 if first == SEND else 1] for messages in pairs]
            for first, second in pairs
        ],
        dtype=np.float64,
    )
