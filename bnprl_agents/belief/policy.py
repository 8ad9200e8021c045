"""A policy on two beliefs, and its unbounded parameters.

Glossary: Z hidden states of the model, M of the memory, A actions, O observations (the null
observation included), n copies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.controllers.controller import normalised
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.settings import check_entries
from bnprl_agents.softmax import softmax


class Filter(NamedTuple):
    """An input-output hidden Markov model of what is observed, Z hidden states.

    The belief f_t(i) = p(z_t = i | o_0, a_0, ..., o_t) follows Bayes' rule,
    f'(j) ~ sum_i f(i) transition[a, i, j] emission[o, j].

    Attributes:
        initial: (O, Z) p(z_0 | o_0).
        transition: (A, Z, Z) p(z' = j, the episode goes on | z = i, a).
        termination: (A, Z) p(the episode ends | z = i, a); with `transition` it sums to 1.
        emission: (O, Z) p(o' | z' = j).
    """

    initial: FloatArray
    transition: FloatArray
    termination: FloatArray
    emission: FloatArray

    def advance(self, belief: FloatArray, action: IntArray, observation: IntArray) -> FloatArray:
        """Beliefs (n, Z) after actions (n,) and the observations (n,) that followed."""
        ahead = np.einsum("ni,nij->nj", belief, self.transition[action])
        return normalised(ahead * self.emission[observation])


class BeliefPolicy(NamedTuple):
    """A policy that is log-linear in what it believes and last saw.

    p(a | h) ~ exp(f . action[:, a] + sight[o, a]), where f = (belief of the model, belief of the
    memory) and o is the last observation.

    Attributes:
        model: predicts observations.
        memory: a second filter, which keeps what helps to act.
        action: (Z + M, A) each state's share of the actions' logits.
        sight: (O, A) the last observation's share.
    """

    model: Filter
    memory: Filter
    action: FloatArray
    sight: FloatArray

    def begin(self, observation: IntArray) -> FloatArray:
        """Beliefs (n, Z + M) after the first observations (n,)."""
        return np.concatenate(
            [self.model.initial[observation], self.memory.initial[observation]], axis=1
        )

    def action_probabilities(self, belief: FloatArray, observation: IntArray) -> FloatArray:
        """p(a | h) for beliefs (n, Z + M) and last observations (n,): (n, A)."""
        return softmax(belief @ self.action + self.sight[observation])

    def advance(self, belief: FloatArray, action: IntArray, observation: IntArray) -> FloatArray:
        """Beliefs (n, Z + M) after actions (n,) and the observations (n,) that followed."""
        states = self.model.initial.shape[1]
        return np.concatenate(
            [
                self.model.advance(belief[:, :states], action, observation),
                self.memory.advance(belief[:, states:], action, observation),
            ],
            axis=1,
        )


class FilterLogits(NamedTuple):
    """Unbounded parameters of a `Filter`, or a slope by them.

    Attributes:
        initial: (O, Z).
        transition: (A, Z, Z + 1); the last column is the episode's end.
        emission: (Z, O).
    """

    initial: FloatArray
    transition: FloatArray
    emission: FloatArray

    def filter(self) -> Filter:
        """The filter that the logits stand for."""
        moves = softmax(self.transition)
        return Filter(
            softmax(self.initial),
            np.ascontiguousarray(moves[..., :-1]),
            np.ascontiguousarray(moves[..., -1]),
            np.ascontiguousarray(softmax(self.emission).T),
        )


class Logits(NamedTuple):
    """Unbounded parameters of a `BeliefPolicy`: `FilterLogits` of model and memory, its tables.

    Of the model there is also `reward` (A, Z), the mean reward of each action in each state, which
    only learning needs.
    """

    initial: FloatArray
    transition: FloatArray
    emission: FloatArray
    memory_initial: FloatArray
    memory_transition: FloatArray
    memory_emission: FloatArray
    action: FloatArray
    sight: FloatArray
    reward: FloatArray

    @property
    def model(self) -> FilterLogits:
        """Those of the model."""
        return FilterLogits(*self[:3])

    @property
    def memory(self) -> FilterLogits:
        """Those of the memory."""
        return FilterLogits(*self[3:6])

    def plus(self, model: FilterLogits, reward: FloatArray) -> Logits:
        """With something added to those of the model."""
        moved = (p + q for p, q in zip(self.model, model, strict=True))
        return Logits._make((*moved, *self[3:8], self.reward + reward))

    def policy(self) -> BeliefPolicy:
        """The policy that the logits stand for."""
        return BeliefPolicy(self.model.filter(), self.memory.filter(), self.action, self.sight)


TERMINATION = -2.0
"""First logit of an episode's end: it is rare."""
UNDECIDED = 0.1
"""Standard deviation of the first logits of the actions."""


def random_logits(
    n_states: int, n_memory: int, n_actions: int, n_observations: int, rng: np.random.Generator
) -> Logits:
    """Draw standard normal logits; those of the actions are small, so that all are tried.

    Raises:
        ValueError: a table would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
    """
    for name, size in (("states", n_states), ("memory", n_memory)):
        check_entries(name, n_actions, size, size + 1)
        check_entries(name, n_observations, size)
    model, memory = (
        _random_filter(size, n_actions, n_observations, rng) for size in (n_states, n_memory)
    )
    action = UNDECIDED * rng.normal(size=(n_states + n_memory, n_actions))
    sight, reward = np.zeros((n_observations, n_actions)), np.zeros((n_actions, n_states))
    return Logits(*model, *memory, action, sight, reward)


def _random_filter(
    n_states: int, n_actions: int, n_observations: int, rng: np.random.Generator
) -> FilterLogits:
    transition = rng.normal(size=(n_actions, n_states, n_states + 1))
    transition[..., -1] = TERMINATION
    return FilterLogits(
        initial=np.zeros((n_observations, n_states)),
        transition=transition,
        emission=rng.normal(size=(n_states, n_observations)),
    )
