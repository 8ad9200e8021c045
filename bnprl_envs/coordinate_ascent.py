"""Compiled coordinate ascent over deterministic memoryless joint policies."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from bnprl_envs.sensor_chain import SensorChain
from bnprl_envs.tables import FloatArray

IntArray = npt.NDArray[np.int64]

_PRECISION = 1e-11
"""Largest error of a value while climbing, in units of the largest possible value."""
_GAIN = 1e-9
"""Smallest gain that counts, in the same units."""
_KICK = 0.2
"""Share of the actions redrawn where a climb begins near known policies."""


class _Tables(NamedTuple):
    """A `SensorChain` and the agents' parts of joint indices, for compiled code.

    Attributes:
        state: (Y,) state of each node.
        see_first: (Y + 1,) offsets of the nodes' observations.
        see_outcome: (nnz,) joint observations.
        see_chance: (nnz,) their chances.
        move_first: (A * S + 1,) offsets of the moves of row a * S + s.
        move_node: (nnz',) next nodes.
        move_chance: (nnz',) their chances.
        reward: (A, S) expected rewards.
        start: (S,) distribution.
        parts: (O + 1, N) each agent's part of a joint observation, an index into `policies`.
        strides: (N,) of the joint action.
        choices: (C,) number of actions of each entry of `policies`.
    """

    state: IntArray
    see_first: IntArray
    see_outcome: IntArray
    see_chance: FloatArray
    move_first: IntArray
    move_node: IntArray
    move_chance: FloatArray
    reward: FloatArray
    start: FloatArray
    parts: IntArray
    strides: IntArray
    choices: IntArray


class Ascent:
    """Coordinate ascent on the exact value of one model.

    A joint policy is one flat array of C = sum_i (O_i + 1) actions, agent by agent, each with
    its first action last.
    """

    def __init__(
        self,
        chain: SensorChain,
        action_sizes: Sequence[int],
        observation_sizes: Sequence[int],
        discount: float,
    ) -> None:
        self.discount = discount
        self.sizes = [size + 1 for size in observation_sizes]
        self.scale = float(np.abs(chain.reward).max()) / (1.0 - discount)
        offsets = np.cumsum([0, *self.sizes[:-1]])
        seen = np.indices(tuple(observation_sizes)).reshape(len(self.sizes), -1).T
        parts = np.vstack([seen, observation_sizes]) + offsets
        strides = np.cumprod([1, *reversed(action_sizes[1:])])[::-1]
        self.tables = _Tables(
            chain.state,
            chain.sensor.indptr.astype(np.int64),
            chain.sensor.indices.astype(np.int64),
            chain.sensor.data,
            chain.moves.indptr.astype(np.int64),
            chain.moves.indices.astype(np.int64),
            chain.moves.data,
            chain.reward,
            chain.start,
            parts.astype(np.int64),
            strides.astype(np.int64),
            np.repeat(np.array(action_sizes, dtype=np.int64), self.sizes),
        )

    def restart(
        self,
        random: np.random.Generator,
        late: Callable[[], bool],
        near: IntArray | None = None,
    ) -> tuple[float, IntArray]:
        """Climb from random policies, or from known ones (C,), a fifth of their actions redrawn.

        Returns:
            The value of the local optimum, and its actions (C,).
        """
        policies = random.integers(self.tables.choices)
        if near is not None:
            policies = np.where(random.random(near.size) < _KICK, policies, near)
        return self.climb(policies, random, late), policies

    def climb(
        self, policies: IntArray, random: np.random.Generator, late: Callable[[], bool]
    ) -> float:
        """Improve the policies in place until nothing does, or late; return their value.

        The entries are gone through in random order.
        """
        values = np.zeros(self.tables.state.size)
        best = _evaluate(
            self.tables, policies, self.discount, values, -np.inf, _PRECISION * self.scale
        )
        order = random.permutation(policies.size)
        unchanged = 0
        for entry in itertools.cycle(order):
            improved = _improve(
                self.tables, policies, entry, self.discount, values, best, self.scale
            )
            unchanged = 0 if improved > best else unchanged + 1
            best = improved
            if unchanged == order.size or late():
                return float(best)
        return float(best)

    def as_lists(self, policies: IntArray) -> list[list[int]]:
        """Return one list an agent."""
        return [part.tolist() for part in np.split(policies, np.cumsum(self.sizes[:-1]))]


@njit(cache=True)
def _improve(tables, policies, entry, discount, values, best, scale):  # type: ignore[no-untyped-def]
    """Set one entry to its best action; return the value and keep `values` that of the policy."""
    before = values.copy()
    for action in range(tables.choices[entry]):
        incumbent = policies[entry]
        if action == incumbent:
            continue
        policies[entry] = action
        tried = before.copy()
        threshold = best + _GAIN * scale
        value = _evaluate(tables, policies, discount, tried, threshold, _PRECISION * scale)
        if value > threshold:
            best = value
            values[:] = tried
        else:
            policies[entry] = incumbent
    return best


@njit(cache=True)
def _evaluate(tables, policies, discount, values, threshold, precision):  # type: ignore[no-untyped-def]
    """Value at the start of a policy, or -inf as soon as it cannot be above the threshold.

    Value iteration from `values` (Y,), which is overwritten, with the bounds of
    `planning.fixed_point`.
    """
    joint = _joint_actions(tables, policies)
    first, rows, weights, reward = _rows(tables, joint)
    scale = discount / (1.0 - discount)
    swept = np.empty_like(values)
    n_states = tables.reward.shape[1]
    while True:
        low, high = np.inf, -np.inf
        for node in range(values.size):
            total = 0.0
            for j in range(first[node], first[node + 1]):
                for k in range(tables.move_first[rows[j]], tables.move_first[rows[j] + 1]):
                    total += weights[j] * tables.move_chance[k] * values[tables.move_node[k]]
            swept[node] = reward[node] + discount * total
            change = swept[node] - values[node]
            low, high = min(low, change), max(high, change)
        values[:] = swept
        start = 0.0
        for state in range(n_states):
            if tables.start[state] > 0.0:
                row = joint[-1] * n_states + state
                total = 0.0
                for k in range(tables.move_first[row], tables.move_first[row + 1]):
                    total += tables.move_chance[k] * values[tables.move_node[k]]
                start += tables.start[state] * (tables.reward[joint[-1], state] + discount * total)
        if start + discount * scale * high <= threshold:
            return -np.inf
        if discount * scale * (high - low) <= 2.0 * precision:
            values += scale * (low + high) / 2.0
            return start + discount * scale * (low + high) / 2.0


@njit(cache=True)
def _joint_actions(tables, policies):  # type: ignore[no-untyped-def]
    """Joint action (O + 1,) after each joint observation."""
    joint = np.zeros(tables.parts.shape[0], dtype=np.int64)
    for o in range(joint.size):
        for agent in range(tables.strides.size):
            joint[o] += tables.strides[agent] * policies[tables.parts[o, agent]]
    return joint


@njit(cache=True)
def _rows(tables, joint):  # type: ignore[no-untyped-def]
    """Rows a * S + s that each node takes next, with their chances; mean reward of each node."""
    n_states = tables.reward.shape[1]
    first = np.zeros(tables.state.size + 1, dtype=np.int64)
    rows = np.empty(tables.see_outcome.size, dtype=np.int64)
    weights = np.empty(tables.see_outcome.size)
    reward = np.zeros(tables.state.size)
    n_rows = 0
    for node in range(tables.state.size):
        begin = n_rows
        for j in range(tables.see_first[node], tables.see_first[node + 1]):
            action = joint[tables.see_outcome[j]]
            row = action * n_states + tables.state[node]
            reward[node] += tables.see_chance[j] * tables.reward[action, tables.state[node]]
            k = begin
            while k < n_rows and rows[k] != row:
                k += 1
            if k == n_rows:
                rows[k] = row
                weights[k] = 0.0
                n_rows += 1
            weights[k] += tables.see_chance[j]
        first[node + 1] = n_rows
    return first, rows, weights, reward
