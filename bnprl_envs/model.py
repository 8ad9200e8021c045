"""A (Dec-)POMDP or MDP as arrays, validated once and then immutable.

Shapes use one glossary: A joint actions, O joint observations, S states, N agents. Joint
indices are row-major with the first agent most significant. `T[a, s, s']` is the chance of
the end state s', `O[a, s', o]` the chance of the observation o, which depends on the action
and on the END state, and `R[a, s, s', o]` the reward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Never

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from bnprl_envs.names import Names, index_names
from bnprl_envs.tables import (
    DENSE_LIMIT,
    BoolArray,
    FloatArray,
    as_flags,
    as_reward,
    as_rows,
    check_rows,
    check_sizes,
    divisor,
    frozen,
    identity_rows,
    normalise_rows,
)

if TYPE_CHECKING:
    from bnprl_envs.sampling import ModelSampler

__all__ = ["IntArray", "Names", "TabularModel"]

IntArray = npt.NDArray[np.int64]

LARGEST_REWARD = 1e100
"""Sums and products of larger ones are soon no numbers."""


class TabularModel:
    """A decision process given by tables; one agent or many, observed fully or in part.

    Rows are stored sparse; `transition`, `observation` and `reward` are dense views made on
    request.

    Args:
        transition: (A, S, S) array, or its rows as a sparse (A * S, S) array.
        observation: (A, S', O) array, or its rows as a sparse (A * S, O) array. None means that
            the state itself is observed (an MDP).
        reward: any array that broadcasts to (A, S, S', O), or a sparse (A * S, S) array where
            the observation does not matter.
        start: (S,) distribution of the first state.
        discount: factor in (0, 1]; 1 needs a finite horizon.
        terminal: (S,) booleans; a terminal state must keep itself and earn 0. None: no state.
        action_sizes: actions of each agent (product A). None: one agent with A actions.
        observation_sizes: observations of each agent (product O). None: one agent with O.
        names: words for the indices. None: the indices themselves.

    Raises:
        ValueError: a table is malformed; the message names the table and the first bad row.
    """

    discount: float
    start: FloatArray
    terminal: BoolArray
    action_sizes: tuple[int, ...]
    observation_sizes: tuple[int, ...]
    names: Names
    fully_observed: bool
    transition_rows: csr_array
    """Sparse (A * S, S); row a * S + s is the distribution of the end state."""
    observation_rows: csr_array
    """Sparse (A * S, O); row a * S + s' is the distribution of the joint observation."""
    _reward: FloatArray | csr_array

    def __init__(
        self,
        transition: npt.ArrayLike | csr_array,
        observation: npt.ArrayLike | csr_array | None,
        reward: npt.ArrayLike | csr_array,
        start: npt.ArrayLike,
        discount: float,
        terminal: npt.ArrayLike | None = None,
        action_sizes: Sequence[int] | None = None,
        observation_sizes: Sequence[int] | None = None,
        names: Names | None = None,
    ) -> None:
        start_row = np.array(start, dtype=np.float64)
        if start_row.ndim != 1 or start_row.size == 0:
            raise ValueError(f"start: shape {start_row.shape}, must be (S,)")
        n_states = start_row.size
        moves = as_rows("transition", transition, n_states)
        n_actions = moves.shape[0] // n_states
        seen = (
            identity_rows(n_actions, n_states)
            if observation is None
            else as_rows("observation", observation, n_states)
        )
        actions = tuple(int(size) for size in action_sizes or (n_actions,))
        observations = tuple(int(size) for size in observation_sizes or (seen.shape[1],))
        self.__dict__.update(
            discount=float(discount),
            start=start_row,
            terminal=as_flags("terminal", terminal, n_states),
            action_sizes=actions,
            observation_sizes=observations,
            fully_observed=observation is None,
            transition_rows=moves,
            observation_rows=seen,
            _reward=as_reward(reward, (n_actions, n_states, n_states, seen.shape[1])),
            names=names or index_names(n_states, actions, observations),
        )
        self.validate()
        normalise_rows(moves)
        normalise_rows(seen)
        start_row /= divisor(start_row.sum(), start_row.size)
        for rows in (moves, seen):
            for part in (rows.data, rows.indices, rows.indptr):
                part.flags.writeable = False
        for array in (self.start, self.terminal):
            array.flags.writeable = False

    def __setattr__(self, name: str, value: object) -> Never:
        raise AttributeError(f"TabularModel is immutable: cannot set {name!r}; see replace()")

    def __repr__(self) -> str:
        return (
            f"TabularModel(S={self.n_states}, actions={self.action_sizes}, "
            f"observations={self.observation_sizes}, discount={self.discount})"
        )

    @property
    def n_states(self) -> int:
        """S."""
        return int(self.start.size)

    @property
    def n_actions(self) -> int:
        """A, the number of joint actions."""
        return math.prod(self.action_sizes)

    @property
    def n_observations(self) -> int:
        """O, the number of joint observations; the null observation is not one of them."""
        return math.prod(self.observation_sizes)

    @property
    def n_agents(self) -> int:
        """N."""
        return len(self.action_sizes)

    @cached_property
    def transition(self) -> FloatArray:
        """Dense (A, S, S) view of the transition rows, made on request."""
        return self._dense(self.transition_rows)

    @cached_property
    def observation(self) -> FloatArray:
        """Dense (A, S', O) view of the observation rows, made on request."""
        return self._dense(self.observation_rows)

    @cached_property
    def reward(self) -> FloatArray:
        """Reward table that broadcasts to (A, S, S', O)."""
        if isinstance(self._reward, csr_array):
            return self._dense(self._reward)[..., None]
        return self._reward

    @cached_property
    def support(self) -> tuple[IntArray, IntArray, IntArray]:
        """Action, state and end state of each stored transition, three (nnz,) arrays."""
        counts = np.diff(self.transition_rows.indptr)
        row = np.repeat(np.arange(counts.size, dtype=np.int64), counts)
        return (
            row // self.n_states,
            row % self.n_states,
            self.transition_rows.indices.astype(np.int64),
        )

    @cached_property
    def support_reward(self) -> FloatArray:
        """Reward of each stored transition: (nnz, 1), or (nnz, O) where observations matter."""
        action, state, end = self.support
        if isinstance(self._reward, csr_array):
            picked = self._reward[action * self.n_states + state, end]
            return frozen(np.asarray(picked, dtype=np.float64).reshape(-1, 1))
        sizes = self._reward.shape
        return frozen(self._reward[action % sizes[0], state % sizes[1], end % sizes[2]])

    @cached_property
    def expected_reward(self) -> FloatArray:
        """(A, S) mean reward of an action in a state: sum over s', o of T O R."""
        action, state, end = self.support
        reward = self.support_reward
        if reward.shape[1] == 1:
            mean = reward[:, 0]
        else:
            seen = self.observation_rows[action * self.n_states + end]
            mean = np.asarray(seen.multiply(reward).sum(axis=1), dtype=np.float64).ravel()
        total: FloatArray = np.bincount(
            action * self.n_states + state,
            weights=self.transition_rows.data * mean,
            minlength=self.n_actions * self.n_states,
        ).astype(np.float64)
        return frozen(total.reshape(self.n_actions, self.n_states))

    @cached_property
    def sampler(self) -> ModelSampler:
        """Alias tables of start, transition and observation, for compiled simulation."""
        from bnprl_envs.sampling import model_sampler  # numba: imported where it is needed

        return model_sampler(self)

    def replace(self, **changes: Any) -> TabularModel:
        """Return a copy with some constructor arguments changed, `discount=0.9` say."""
        arguments: dict[str, Any] = {
            "transition": self.transition_rows,
            "observation": None if self.fully_observed else self.observation_rows,
            "reward": self._reward,
            "start": self.start,
            "discount": self.discount,
            "terminal": self.terminal,
            "action_sizes": self.action_sizes,
            "observation_sizes": self.observation_sizes,
            "names": self.names,
        }
        return TabularModel(**(arguments | changes))

    def validate(self) -> None:
        """Check every table.

        Raises:
            ValueError: names the table, the first bad row, what it holds and what is allowed.
        """
        if not 0.0 < self.discount <= 1.0:
            raise ValueError(f"discount: {self.discount}, must lie in (0, 1]")
        n_rows, n_ends = self.transition_rows.shape
        if n_ends != self.n_states:
            raise ValueError(f"transition: {n_ends} end states, but start has {self.n_states}")
        if self.observation_rows.shape[0] != n_rows:
            raise ValueError(
                f"observation: {self.observation_rows.shape[0] // self.n_states} actions, "
                f"but transition has {n_rows // self.n_states}"
            )
        check_sizes("action_sizes", self.action_sizes, n_rows // self.n_states)
        check_sizes("observation_sizes", self.observation_sizes, self.observation_rows.shape[1])
        self._check_names()
        check_rows("start", csr_array(self.start[None]), lambda row: "")
        check_rows("transition", self.transition_rows, self._row_name)
        check_rows("observation", self.observation_rows, self._row_name)
        table = self._reward.data if isinstance(self._reward, csr_array) else self._reward
        if not np.isfinite(table).all():
            raise ValueError("reward: holds NaN or infinity, must be finite")
        largest = np.abs(table).max(initial=0.0)
        if largest > LARGEST_REWARD:
            raise ValueError(f"reward: holds ±{largest:g}, must lie within ±{LARGEST_REWARD:g}")
        self._check_terminal()

    def _check_names(self) -> None:
        names = self.names
        shape = (
            len(names.states),
            tuple(map(len, names.actions)),
            tuple(map(len, names.observations)),
            len(names.agents),
        )
        wanted = (self.n_states, self.action_sizes, self.observation_sizes, self.n_agents)
        if shape != wanted:
            raise ValueError(
                f"names: {shape} (states, actions, observations, agents), must be {wanted}"
            )

    def _check_terminal(self) -> None:
        _, state, end = self.support
        exits = self.terminal[state] & (end != state)
        if exits.any():
            k = int(np.argmax(exits))
            raise ValueError(
                f"terminal: state {self.names.states[state[k]]!r} has an exit to "
                f"{self.names.states[end[k]]!r}; it must keep itself under every action"
            )
        earns = self.terminal[state] & (self.support_reward != 0).any(axis=1)
        if earns.any():
            k = int(np.argmax(earns))
            raise ValueError(
                f"terminal: state {self.names.states[state[k]]!r} has a reward; it must earn 0"
            )

    def _row_name(self, row: int) -> str:
        action, state = divmod(row, self.n_states)
        parts = np.unravel_index(action, self.action_sizes)
        words = (names[int(i)] for names, i in zip(self.names.actions, parts, strict=True))
        return f" row of action {' '.join(words)!r}, state {self.names.states[state]!r}"

    def _dense(self, rows: csr_array) -> FloatArray:
        if math.prod(rows.shape) > DENSE_LIMIT:
            raise ValueError(
                f"a dense table of {math.prod(rows.shape):,} entries exceeds {DENSE_LIMIT:,}; "
                "use the sparse rows"
            )
        return frozen(rows.toarray().reshape(self.n_actions, self.n_states, -1))
