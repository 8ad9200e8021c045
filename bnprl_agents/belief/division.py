"""A state that is hardly used becomes half of the most used one.

Likelihood has many local optima, in most of which some states stand for several situations and
others for none. Dividing a state changes neither the beliefs' meaning nor the policy, up to the
little that the unused state held; the two halves then grow apart.
"""

from __future__ import annotations

import numpy as np

from bnprl_agents.belief.policy import Logits
from bnprl_agents.episodes import FloatArray
from bnprl_agents.proximal.actor import Actor

HARDLY = 0.01
"""A state is hardly used below this share of the most used one's mean belief."""
APART = 0.1
"""Standard deviation of the noise on the new half's logits, without which both stay alike."""
STATE_AXES = {
    "initial": (1,),
    "transition": (1, 2),
    "emission": (0,),
    "action": (0,),
    "reward": (1,),
}
"""The axes of `Logits` that are states of the model."""


def divided(actor: Actor[Logits], use: FloatArray, rng: np.random.Generator) -> Actor[Logits]:
    """Divide the most used state if another is hardly used, which its half replaces.

    Args:
        actor: what was learned so far.
        use: (Z,) mean belief of the model's states.
        rng: source of the noise; not advanced where nothing is divided.

    Returns:
        The actor with logits, their moments and the critic of the two halves.
    """
    state, place = int(use.argmax()), int(use.argmin())
    if use[place] > HARDLY * use[state]:
        return actor
    moments = actor.moments
    return actor._replace(
        logits=_halved(copied(actor.logits, state, place), state, place, rng),
        moments=moments._replace(
            mean=copied(moments.mean, state, place), square=copied(moments.square, state, place)
        ),
        critic=actor.critic.divided(state, place),
    )


def copied(tables: Logits, state: int, place: int) -> Logits:
    """Tables in which a place of the model holds what a state does."""
    changed = {name: getattr(tables, name).copy() for name in STATE_AXES}
    for name, axes in STATE_AXES.items():
        for axis in axes:
            states = np.moveaxis(changed[name], axis, 0)
            states[place] = states[state]
    return tables._replace(**changed)


def _halved(logits: Logits, state: int, place: int, rng: np.random.Generator) -> Logits:
    """Give two equal states half of their mass each, and set the second a little apart."""
    initial, transition, emission = (table.copy() for table in logits.model)
    for arrivals in (initial, transition):
        arrivals[..., [state, place]] -= np.log(2.0)
    for rows in (initial[:, place], transition[:, place], transition[..., place], emission[place]):
        rows += APART * rng.normal(size=rows.shape)
    return logits._replace(initial=initial, transition=transition, emission=emission)
