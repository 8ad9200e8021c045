"""Finite-state controllers: policies with memory (dissertation, chapters 2, 4 and 6).

Glossary: Z nodes, A actions, O observations of one agent (for the tabular environments the last
one is the null observation that `reset` returns), n copies of an environment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.settings import check_entries


@dataclass(frozen=True, eq=False)
class Controller:
    """A stochastic finite-state controller of one agent; Definition 1 of the dissertation.

    Its node is never sampled: acting filters the distribution over nodes, so that the controller
    is a map from histories to action distributions (the regionalized policy representation).

    Attributes:
        initial: (O, Z) node distribution after each possible first observation. One row, (1, Z),
            stands for all of them.
        action: (Z, A) action distribution of each node, pi.
        successor: (A, O, Z, Z) node distribution after taking a in z and then seeing o, W.

    Raises:
        ValueError: shapes disagree or an entry is negative or not finite. Rows need not sum to 1:
            the E-step also takes the under-normalised parameters of variational Bayes.
    """

    initial: FloatArray
    action: FloatArray
    successor: FloatArray

    def __post_init__(self) -> None:
        action = _table("action", self.action, 2)
        successor = _table("successor", self.successor, 4)
        initial = _table("initial", self.initial, 2)
        n_nodes, n_actions = action.shape
        if successor.shape != (n_actions, successor.shape[1], n_nodes, n_nodes):
            raise ValueError(
                f"successor: shape {successor.shape}, must be "
                f"({n_actions}, O, {n_nodes}, {n_nodes})"
            )
        if initial.shape[0] == 1:
            initial = np.repeat(initial, successor.shape[1], axis=0)
        if initial.shape != (successor.shape[1], n_nodes):
            raise ValueError(
                f"initial: shape {initial.shape}, must be ({successor.shape[1]}, {n_nodes})"
            )
        for name, table in (("initial", initial), ("action", action), ("successor", successor)):
            object.__setattr__(self, name, table)

    @property
    def n_nodes(self) -> int:
        """Z."""
        return int(self.action.shape[0])

    @property
    def n_actions(self) -> int:
        """A."""
        return int(self.action.shape[1])

    @property
    def n_observations(self) -> int:
        """O, every value of the observation space."""
        return int(self.successor.shape[1])

    def begin(self, observation: IntArray) -> FloatArray:
        """Node distributions (n, Z) after the first observations (n,)."""
        return normalised(self.initial[observation])

    def action_probabilities(self, belief: FloatArray) -> FloatArray:
        """p(a | h) for node distributions (n, Z): (n, A)."""
        return normalised(belief @ self.action)

    def advance(self, belief: FloatArray, action: IntArray, observation: IntArray) -> FloatArray:
        """Filter node distributions (n, Z) by actions (n,) and the observations (n,) after them.

        f'(j) is proportional to sum_i f(i) action[i, a] successor[a, o, i, j]. A history that the
        controller cannot produce (all mass 0) gives the uniform distribution.
        """
        weighted = belief * self.action[:, action].T
        return normalised(np.einsum("ni,nij->nj", weighted, self.successor[action, observation]))


def restored_team(
    arrays: Arrays, names: str, action_sizes: Sequence[int], observation_sizes: Sequence[int]
) -> tuple[tuple[Controller, ...], tuple[FloatArray, ...]]:
    """Each agent's controller and exploration (Z,) from a policy file.

    Args:
        arrays: of the file.
        names: of its arrays, in which {} stands for initial, action, successor or explore; the
            agent's number follows.
        action_sizes: (N,) actions of each agent.
        observation_sizes: (N,) observations of each agent.

    Raises:
        ValueError: they do not fit each other or the sizes, or a probability is none.
    """
    controllers, explore = [], []
    for n, sizes in enumerate(zip(action_sizes, observation_sizes, strict=True)):
        tables = (arrays[names.format(k) + str(n)] for k in ("initial", "action", "successor"))
        controller = Controller(*tables)
        if (controller.n_actions, controller.n_observations) != sizes:
            raise ValueError(f"{names.format('action')}{n}: does not fit the spaces")
        controllers.append(controller)
        name = f"{names.format('explore')}{n}"
        explore.append(restored_exploration(arrays, name, controller.n_nodes))
    return tuple(controllers), tuple(explore)


def restored_exploration(arrays: Arrays, name: str, n_nodes: int) -> FloatArray:
    """How probably each node (Z,) explores, from a policy file.

    Raises:
        ValueError: they are not as many, or a probability is none.
    """
    explore = taken(arrays, name, (n_nodes,))
    if ((explore < 0.0) | (explore > 1.0)).any():
        raise ValueError(f"{name}: {explore.tolist()}, must lie in [0, 1]")
    return explore


def normalised(rows: FloatArray) -> FloatArray:
    """Divide by the sum over the last axis; a row of zeros becomes uniform."""
    total = rows.sum(axis=-1, keepdims=True)
    positive = total > 0.0
    shares: FloatArray = np.where(positive, rows, 1.0) / np.where(positive, total, rows.shape[-1])
    return shares


def uniform_controller(n_actions: int, n_observations: int) -> Controller:
    """One node that chooses uniformly among the actions.

    Raises:
        ValueError: a table would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
    """
    check_entries("observation_space", n_actions, n_observations)
    return Controller(
        initial=np.ones((n_observations, 1)),
        action=np.full((1, n_actions), 1.0 / n_actions),
        successor=np.ones((n_actions, n_observations, 1, 1)),
    )


def random_controller(
    n_nodes: int,
    n_actions: int,
    n_observations: int,
    rng: np.random.Generator,
    successor_concentration: float = 1.0,
) -> Controller:
    """Draw every row from a symmetric Dirichlet distribution, uniform but for the successors.

    Args:
        n_nodes: Z.
        n_actions: A.
        n_observations: O.
        rng: source of the draws.
        successor_concentration: parameter of the successor rows' Dirichlet; 1 is uniform over
            the simplex, small values give nearly deterministic rows, which remember longer.

    Raises:
        ValueError: a table would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
    """
    check_entries("nodes", n_actions, n_observations, n_nodes, n_nodes)

    def rows(*shape: int, concentration: float = 1.0) -> FloatArray:
        gamma = rng.gamma(concentration, size=shape)
        return normalised(np.maximum(gamma, np.finfo(np.float64).tiny))

    return Controller(
        initial=rows(n_observations, n_nodes),
        action=rows(n_nodes, n_actions),
        successor=rows(
            n_actions, n_observations, n_nodes, n_nodes, concentration=successor_concentration
        ),
    )


def _table(name: str, table: npt.ArrayLike, ndim: int) -> FloatArray:
    array = np.ascontiguousarray(table, dtype=np.float64)
    if array.ndim != ndim or 0 in array.shape:
        raise ValueError(f"{name}: shape {array.shape}, must have {ndim} axes, none empty")
    if not np.isfinite(array).all() or (array < 0.0).any():
        raise ValueError(f"{name}: holds a negative or non-finite entry, must be probabilities")
    return array
