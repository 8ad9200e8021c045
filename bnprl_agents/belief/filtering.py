"""The compiled filter: beliefs of whole episodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.belief.policy import BeliefPolicy
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray

NEGLIGIBLE = 1e-5
"""Belief below which a state's row is skipped."""


class Beliefs(NamedTuple):
    """Beliefs before each action, (S, Z), and after each episode's last observation, (K, Z).

    Those of terminated episodes are not defined, and 0.
    """

    before: FloatArray
    final: FloatArray


def filter_beliefs(episodes: EpisodeBatch, policy: BeliefPolicy) -> Beliefs:
    """Filter every episode of one agent."""
    return Beliefs(
        *_filter(
            episodes.offsets,
            episodes.observations[:, 0],
            episodes.actions[:, 0],
            next_observations(episodes),
            episodes.terminated,
            policy.initial,
            policy.transition,
            np.ascontiguousarray(policy.emission.T),
        )
    )


def next_observations(episodes: EpisodeBatch) -> IntArray:
    """Observation (S,) of the only agent after each action."""
    after = np.roll(episodes.observations[:, 0], -1)
    after[episodes.offsets[1:] - 1] = episodes.final_observations[:, 0]
    return after


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def predict(belief, move, emission, ahead):  # type: ignore[no-untyped-def]
    """Write p(z' | h, a) to `ahead`; return the likelihood of the observation."""
    ahead[:] = 0.0
    for i in range(belief.size):
        weight = belief[i]
        if weight > NEGLIGIBLE:
            for j in range(belief.size):
                ahead[j] += weight * move[i, j]
    likelihood = 0.0
    for j in range(belief.size):
        likelihood += ahead[j] * emission[j]
    return likelihood


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def action_probabilities(belief, action):  # type: ignore[no-untyped-def]
    """p(a | h) of a belief (Z,) and logits (A, Z): (A,)."""
    p = np.zeros(action.shape[0])
    for u in range(p.size):
        for i in range(belief.size):
            p[u] += belief[i] * action[u, i]
    p = np.exp(p - p.max())
    return p / p.sum()


@njit(cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def _filter(offsets, observations, actions, after, terminated, initial, transition, emission):  # type: ignore[no-untyped-def]
    n_states = initial.shape[1]
    before, final = np.zeros((actions.size, n_states)), np.zeros((terminated.size, n_states))
    ahead = np.empty(n_states)
    for k in range(terminated.size):
        belief = initial[observations[offsets[k]]].copy()
        for t in range(offsets[k], offsets[k + 1]):
            before[t] = belief
            if t + 1 == offsets[k + 1] and terminated[k]:
                break
            seen = emission[after[t]]
            likelihood = predict(belief, transition[actions[t]], seen, ahead)
            belief[:] = ahead * seen / likelihood
            final[k] = belief
        if terminated[k]:
            final[k] = 0.0
    return before, final
