"""The exact value of controllers on a known model: one linear system, (2.24) and (2.35)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.rollout import check_fit
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_envs.model import TabularModel

TOLERANCE = 1e-10
"""Relative residual of the linear system. The error of V at any state and nodes, the largest, is
below this times the 2-norm of the rewards r(s, z), over 1 - discount."""


def controller_value(
    model: TabularModel, controllers: Controller | Sequence[Controller], discount: float
) -> float:
    """Expected discounted return of the controllers over an infinite horizon, exactly.

    V(s, z) = sum_a pi(z, a) [r(s, a) + gamma sum_{s', o, z'} T O W V(s', z')], where z holds one
    node an agent; solved by GMRES without forming the matrix, so that it costs
    O(A O S Z^2) an iteration and O(E prod Z) memory, E the possible pairs (s', o) of an action.

    Args:
        model: the true model of N agents.
        controllers: one for each agent; a single one is a team of one.
        discount: factor in (0, 1).

    Raises:
        ValueError: the controllers do not fit the model, their rows do not sum to 1, or the
            discount lies outside (0, 1).
        ArithmeticError: the solver did not reach `TOLERANCE`.
    """
    team = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    check_fit(model, team)
    for n, controller in enumerate(team):
        _check_normalised(n, controller)
    if not 0.0 < discount < 1.0:
        raise ValueError(f"discount: {discount}, must lie in (0, 1) for an infinite horizon")
    value = _solve(model, team, discount)
    return float(np.sum(_start_weights(model, team) * value))


def _solve(model: TabularModel, team: Sequence[Controller], discount: float) -> FloatArray:
    shape = (model.n_states, *(c.n_nodes for c in team))
    size = math.prod(shape)
    backup = _JointBackup(model, team)

    def residual_operator(flat: FloatArray) -> FloatArray:
        value = flat.reshape(shape)
        return (value - discount * backup.expected(value)).ravel()

    operator = LinearOperator((size, size), matvec=residual_operator, dtype=np.float64)
    reward = backup.reward().ravel()
    solution, failed = gmres(operator, reward, rtol=TOLERANCE, atol=0.0, restart=60, maxiter=200)
    if failed:
        raise ArithmeticError(f"the value's linear system of size {size} did not converge")
    return solution.reshape(shape)


class _JointAction(NamedTuple):
    """What one joint action does, with one entry for each possible (s', o), E in all.

    Attributes:
        parts: the agents' actions.
        chosen: (Z_1, ..., Z_N) p(a | z).
        transition: (S, S) T.
        ends: (E,) s' of each entry.
        seen: for each agent and each of its observations, the entries with that observation.
        observation: (S, E) O(o | a, s') of s' and its entries.
    """

    parts: tuple[int, ...]
    chosen: FloatArray
    transition: csr_array
    ends: IntArray
    seen: list[list[IntArray]]
    observation: csr_array


class _JointBackup:
    """One step of model and controllers together, as linear maps on V (S, Z_1, ..., Z_N)."""

    def __init__(self, model: TabularModel, team: Sequence[Controller]) -> None:
        self.model, self.team = model, team
        self.alive = ~model.terminal
        self.actions = [self._joint_action(joint) for joint in range(model.n_actions)]

    def _joint_action(self, joint: int) -> _JointAction:
        size = self.model.n_states
        rows = slice(joint * size, (joint + 1) * size)
        parts = tuple(int(part) for part in np.unravel_index(joint, self.model.action_sizes))
        each = [c.action[:, a] for c, a in zip(self.team, parts, strict=True)]
        chance = coo_array(self.model.observation_rows[rows])
        ends, joint_seen = chance.coords
        sizes = self.model.observation_sizes
        return _JointAction(
            parts,
            reduce(np.multiply.outer, each),
            self.model.transition_rows[rows],
            ends.astype(np.int64),
            [
                [np.flatnonzero(seen == o) for o in range(n)]
                for seen, n in zip(np.unravel_index(joint_seen, sizes), sizes, strict=True)
            ],
            csr_array((chance.data, (ends, np.arange(ends.size))), shape=(size, ends.size)),
        )

    def reward(self) -> FloatArray:
        """sum_a p(a | z) r(s, a): (S, Z_1, ..., Z_N)."""
        total = np.zeros((self.model.n_states, *(c.n_nodes for c in self.team)))
        for mean, joint in zip(self.model.expected_reward, self.actions, strict=True):
            total += np.multiply.outer(mean, joint.chosen)
        return total

    def expected(self, value: FloatArray) -> FloatArray:
        """Mean of V over the next states and nodes."""
        value = value * self.alive.reshape((-1,) + (1,) * len(self.team))
        total = np.zeros_like(value)
        for joint in self.actions:
            after = self._over_nodes(value, joint)
            moved = joint.transition @ after.reshape(after.shape[0], -1)
            total += joint.chosen * moved.reshape(value.shape)
        return total

    def _over_nodes(self, value: FloatArray, action: _JointAction) -> FloatArray:
        """sum_{o, z'} O(o | a, s') W(z' | z, a, o) V(s', z') as a function of (s', z)."""
        ahead = value[action.ends]
        for n, (c, a, every) in enumerate(zip(self.team, action.parts, action.seen, strict=True)):
            for o, entries in enumerate(every):
                moved = np.tensordot(ahead[entries], c.successor[a, o], (n + 1, 1))
                ahead[entries] = np.moveaxis(moved, -1, n + 1)
        found: FloatArray = action.observation @ ahead.reshape(action.ends.size, -1)
        return found.reshape(value.shape)


def _start_weights(model: TabularModel, team: Sequence[Controller]) -> FloatArray:
    """Joint distribution (S, Z_1, ..., Z_N) of the first state and nodes."""
    if model.fully_observed:
        return model.start[:, None] * team[0].initial
    nodes = [c.initial[size] for c, size in zip(team, model.observation_sizes, strict=True)]
    return reduce(np.multiply.outer, nodes, model.start)


def _check_normalised(agent: int, controller: Controller) -> None:
    for name in ("initial", "action", "successor"):
        off = np.abs(getattr(controller, name).sum(axis=-1) - 1.0).max()
        if off > 1e-6:
            raise ValueError(f"controller of agent {agent}: a row of {name} is off 1 by {off:.2g}")
