"""Compiled backups of value functions on the sparse rows of a model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from bnprl_envs.model import TabularModel
from bnprl_envs.tables import FloatArray

Int32Array = npt.NDArray[np.int32]


class Rows(NamedTuple):
    """The tables of a model for compiled code; entries first[r] to first[r + 1] belong to row r.

    Attributes:
        n_observations: O.
        move_first: (A * S + 1,) offsets of the transition rows a * S + s.
        move_end: (nnz,) end states.
        move_chance: (nnz,) their chances.
        see_first: (A * S + 1,) offsets of the observation rows a * S + s'.
        see_outcome: (nnz',) joint observations.
        see_chance: (nnz',) their chances.
        reward: (A, S) expected rewards.
    """

    n_observations: int
    move_first: Int32Array
    move_end: Int32Array
    move_chance: FloatArray
    see_first: Int32Array
    see_outcome: Int32Array
    see_chance: FloatArray
    reward: FloatArray


def model_rows(model: TabularModel) -> Rows:
    """Return the tables of a model."""
    moves, seen = model.transition_rows, model.observation_rows
    return Rows(
        model.n_observations,
        moves.indptr.astype(np.int32),
        moves.indices.astype(np.int32),
        moves.data,
        seen.indptr.astype(np.int32),
        seen.indices.astype(np.int32),
        seen.data,
        model.expected_reward,
    )


@njit(cache=True)
def fib_backup(rows, discount, vectors):  # type: ignore[no-untyped-def]
    """One sweep of the fast informed bound (Hauskrecht 2000, section 4.2).

    f(a, s) = r(a, s) + discount sum_o max_a' sum_s' T(a, s, s') O(a, s', o) f'(a', s').

    Args:
        rows: the tables.
        discount: in [0, 1).
        vectors: (A, S), f'.

    Returns:
        (A, S), f.
    """
    n_actions, n_states = rows.reward.shape
    transposed = np.ascontiguousarray(vectors.T)
    result = np.empty((n_actions, n_states))
    scores = np.zeros((rows.n_observations, n_actions))
    touched = np.zeros(rows.n_observations, dtype=np.bool_)
    seen = np.empty(rows.n_observations, dtype=np.int64)
    for action in range(n_actions):
        for state in range(n_states):
            n_seen = 0
            row = action * n_states + state
            for k in range(rows.move_first[row], rows.move_first[row + 1]):
                after = transposed[rows.move_end[k]]
                end = action * n_states + rows.move_end[k]
                for j in range(rows.see_first[end], rows.see_first[end + 1]):
                    o = rows.see_outcome[j]
                    if not touched[o]:
                        touched[o] = True
                        seen[n_seen] = o
                        n_seen += 1
                    scores[o] += rows.move_chance[k] * rows.see_chance[j] * after
            total = 0.0
            for i in range(n_seen):
                total += scores[seen[i]].max()
                scores[seen[i]] = 0.0
                touched[seen[i]] = False
            result[action, state] = rows.reward[action, state] + discount * total
    return result


@njit(cache=True)
def predict(rows, action, states, chances):  # type: ignore[no-untyped-def]
    """Distribution (S,) of the end state after an action from a sparse belief."""
    n_states = rows.reward.shape[1]
    predicted = np.zeros(n_states)
    for i in range(states.size):
        row = action * n_states + states[i]
        for k in range(rows.move_first[row], rows.move_first[row + 1]):
            predicted[rows.move_end[k]] += chances[i] * rows.move_chance[k]
    return predicted


@njit(cache=True)
def sample_successor(rows, terminal, action, states, chances, uniform):  # type: ignore[no-untyped-def]
    """Belief (S,) after an action and an observation drawn by a uniform number in [0, 1).

    The belief is that of an episode which goes on; zeros if none can.
    """
    n_states = rows.reward.shape[1]
    predicted = predict(rows, action, states, chances)
    predicted[terminal] = 0.0
    seen = np.zeros(rows.n_observations)
    for end in range(n_states):
        row = action * n_states + end
        for j in range(rows.see_first[row], rows.see_first[row + 1]):
            seen[rows.see_outcome[j]] += predicted[end] * rows.see_chance[j]
    total = np.cumsum(seen)
    if total[-1] <= 0.0:
        return predicted
    outcome = np.searchsorted(total, uniform * total[-1], side="right")
    for end in range(n_states):
        row = action * n_states + end
        chance = 0.0
        for j in range(rows.see_first[row], rows.see_first[row + 1]):
            if rows.see_outcome[j] == outcome:
                chance = rows.see_chance[j]
        predicted[end] *= chance / seen[outcome]
    return predicted


@njit(cache=True)
def point_backup(rows, discount, states, chances, vectors):  # type: ignore[no-untyped-def]
    """Best vector at one belief after one step, then the best of `vectors` (Pineau et al. 2003).

    Args:
        rows: the tables.
        discount: in [0, 1).
        states: states that the belief holds possible.
        chances: their probabilities.
        vectors: (S, n), one vector a column.

    Returns:
        The vector (S,) and its action.
    """
    best_value, best_action = -np.inf, 0
    choice = np.zeros(rows.n_observations, dtype=np.int64)
    best_choice = choice.copy()
    scores = np.empty((rows.n_observations, vectors.shape[1]))
    for action in range(rows.reward.shape[0]):
        value = discount * _choose(rows, action, states, chances, vectors, scores, choice)
        for i in range(states.size):
            value += chances[i] * rows.reward[action, states[i]]
        if value > best_value:
            best_value, best_action = value, action
            best_choice[:] = choice
    return _step_back(rows, discount, best_action, best_choice, vectors), best_action


@njit(cache=True)
def _choose(rows, action, states, chances, vectors, scores, choice):  # type: ignore[no-untyped-def]
    """Choose the best vector after each observation (0 after impossible ones); return its mean."""
    n_states = rows.reward.shape[1]
    predicted = predict(rows, action, states, chances)
    choice[:] = -1
    for end in range(n_states):
        if predicted[end] > 0.0:
            after = vectors[end]
            row = action * n_states + end
            for j in range(rows.see_first[row], rows.see_first[row + 1]):
                weight = predicted[end] * rows.see_chance[j]
                score = scores[rows.see_outcome[j]]
                if choice[rows.see_outcome[j]] < 0:
                    choice[rows.see_outcome[j]] = 0
                    score[:] = 0.0
                for i in range(score.size):
                    score[i] += weight * after[i]
    total = 0.0
    for o in range(rows.n_observations):
        if choice[o] == 0:
            choice[o] = scores[o].argmax()
            total += scores[o, choice[o]]
        else:
            choice[o] = 0
    return total


@njit(cache=True)
def _step_back(rows, discount, action, choice, vectors):  # type: ignore[no-untyped-def]
    """Value (S,) of an action followed, after observation o, by the vector choice[o]."""
    n_states = rows.reward.shape[1]
    after = np.zeros(n_states)
    for end in range(n_states):
        row = action * n_states + end
        for j in range(rows.see_first[row], rows.see_first[row + 1]):
            after[end] += rows.see_chance[j] * vectors[end, choice[rows.see_outcome[j]]]
    vector = rows.reward[action].copy()
    for state in range(n_states):
        row = action * n_states + state
        for k in range(rows.move_first[row], rows.move_first[row + 1]):
            vector[state] += discount * rows.move_chance[k] * after[rows.move_end[k]]
    return vector
