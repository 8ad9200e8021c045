"""A policy on the belief of an input-output hidden Markov model, and its unbounded parameters.

Glossary: Z hidden states, A actions, O observations (the null observation included), n copies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.controllers.controller import normalised
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.softmax import softmax


class BeliefPolicy(NamedTuple):
    """A hidden Markov model of what is observed, and a policy that is log-linear in its belief.

    The belief f_t(i) = p(z_t = i | o_0, a_0, ..., o_t) follows Bayes' rule,
    f'(j) ~ sum_i f(i) transition[a, i, j] emission[j, o], and p(a | h) ~ exp(f . action[:, a]).

    Attributes:
        initial: (O, Z) p(z_0 | o_0).
        transition: (A, Z, Z) p(z' = j, the episode goes on | z = i, a).
        termination: (A, Z) p(the episode ends | z = i, a); with `transition` it sums to 1.
        emission: (Z, O) p(o' | z' = j).
        action: (Z, A) each state's share of the actions' logits.
    """

    initial: FloatArray
    transition: FloatArray
    termination: FloatArray
    emission: FloatArray
    action: FloatArray

    def begin(self, observation: IntArray) -> FloatArray:
        """Beliefs (n, Z) after the first observations (n,)."""
        return self.initial[observation]

    def action_probabilities(self, belief: FloatArray) -> FloatArray:
        """p(a | h) for beliefs (n, Z): (n, A)."""
        return softmax(belief @ self.action)

    def advance(self, belief: FloatArray, action: IntArray, observation: IntArray) -> FloatArray:
        """Beliefs (n, Z) after actions (n,) and the observations (n,) that followed."""
        ahead = np.einsum("ni,nij->nj", belief, self.transition[action])
        return normalised(ahead * self.emission[:, observation].T)


class Logits(NamedTuple):
    """Unbounded parameters of a `BeliefPolicy`.

    Attributes:
        initial: (O, Z).
        transition: (A, Z, Z + 1); the last column is the episode's end.
        emission: (Z, O).
        action: (Z, A), the policy's own.
    """

    initial: FloatArray
    transition: FloatArray
    emission: FloatArray
    action: FloatArray

    def policy(self) -> BeliefPolicy:
        """The policy that the logits stand for."""
        moves = softmax(self.transition)
        return BeliefPolicy(
            softmax(self.initial),
            np.ascontiguousarray(moves[..., :-1]),
            np.ascontiguousarray(moves[..., -1]),
            softmax(self.emission),
            self.action,
        )


TERMINATION = -2.0
"""First logit of an episode's end: it is rare."""
UNDECIDED = 0.1
"""Standard deviation of the first logits of the actions."""


def random_logits(
    n_states: int, n_actions: int, n_observations: int, rng: np.random.Generator
) -> Logits:
    """Draw standard normal logits; those of the actions are small, so that all are tried."""
    transition = rng.normal(size=(n_actions, n_states, n_states + 1))
    transition[..., -1] = TERMINATION
    return Logits(
        initial=np.zeros((n_observations, n_states)),
        transition=transition,
        emission=rng.normal(size=(n_states, n_observations)),
        action=UNDECIDED * rng.normal(size=(n_states, n_actions)),
    )
