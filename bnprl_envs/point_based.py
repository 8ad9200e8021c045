"""A lower bound of a POMDP's optimum, and a policy that goes with it, by point-based backups."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, vstack

from bnprl_envs.backups import model_rows, point_backup, sample_successor
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import blind_vectors, infinite_horizon_discount
from bnprl_envs.tables import FloatArray

Progress = Callable[[float, float], None]
"""Called with the seconds used and the lower bound so far."""

IntArray = npt.NDArray[np.int64]
SparseBelief = tuple[IntArray, FloatArray]
"""States that a belief holds possible, and their probabilities."""

MAX_BELIEFS = 10_000
"""Beliefs that are backed up, at most."""
_NEW_BELIEFS = 100
"""Beliefs added in a round, at most."""
_SWEEPS = 5
"""Sweeps over the beliefs in a round."""
_NOVEL = 1e-6
"""L1 distance below which two beliefs are the same."""
_EXPLORATION = 0.2
"""Chance of a random action when trajectories look for new beliefs."""
_NEGLIGIBLE = 1e-12
"""Probability below which exploring takes a state for impossible."""
_GAIN = 1e-12
"""Relative gain of a sweep below which its round is over."""
_IDLE_ROUNDS = 10
"""Rounds without a new belief or a gain after which the search is over."""


@dataclass(frozen=True)
class PointBasedPolicy:
    """Vectors below the optimal value function, each with its action.

    Attributes:
        vectors: (n, S); the bound of a belief b is max_i b . vectors[i].
        actions: (n,) joint actions.
        value: the bound at the start distribution.
    """

    vectors: FloatArray
    actions: IntArray
    value: float

    def act(self, belief: npt.ArrayLike) -> int:
        """Return the action of the vector that is best at a belief (S,)."""
        return int(self.actions[np.argmax(self.vectors @ np.asarray(belief, dtype=np.float64))])


def point_based_lower_bound(
    model: TabularModel,
    *,
    seconds: float,
    seed: int = 0,
    discount: float | None = None,
    on_progress: Progress | None = None,
) -> PointBasedPolicy:
    """Improve a lower bound of the optimal value for some time.

    Perseus (Spaan and Vlassis 2005): sweeps of backups at beliefs in random order that skip
    those already improved. It begins with the values of blind policies, and a backup of a lower
    bound is one, so that every vector stays below the optimum. Between sweeps beliefs are added
    as in PBVI (Pineau, Gordon and Thrun 2003): for each known one the successor that is farthest
    from all known, half of the known ones drawn at random and half from trajectories of the
    policy so far. Of many agents it bounds the centralised problem.

    How far it gets depends on the machine; with enough seconds small problems end by themselves.

    Args:
        model: partially observed; one agent or many (as one that sees the joint observation).
        seconds: time to spend, over 0; preparing (compiling too) is not counted.
        seed: of the exploration.
        discount: instead of the model's.
        on_progress: called after every sweep.

    Returns:
        Vectors, actions and the bound at the start.

    Raises:
        ValueError: the model is fully observed (see `mdp_value`), the time is not positive or
            the discount not below 1.
    """
    if model.fully_observed:
        raise ValueError("model: fully observed, where mdp_value is exact; must be a POMDP")
    if not seconds > 0:
        raise ValueError(f"seconds: {seconds}, must be over 0")
    search = _Search(model, infinite_horizon_discount(model, discount), seed)
    search.prepare()
    search.run(seconds, on_progress)
    return search.policy()


class _Search:
    """The beliefs (sparse, the start first), the vectors and their values at the beliefs."""

    def __init__(self, model: TabularModel, discount: float, seed: int) -> None:
        self.model, self.discount = model, discount
        self.rows = model_rows(model)
        self.random = np.random.default_rng(seed)
        self.beliefs = csr_array(model.start[None])
        vectors = blind_vectors(model, discount)
        self._keep(vectors, np.arange(len(vectors)))

    def policy(self) -> PointBasedPolicy:
        return PointBasedPolicy(self.vectors, self.actions, float(self.values[0]))

    def prepare(self) -> None:
        """Do everything once, so that it is compiled."""
        self._sweep(lambda: False)
        self._expand(lambda: False)

    def run(self, seconds: float, on_progress: Progress | None) -> None:
        """Sweep and expand until the time is over or nothing more is found."""
        began = time.perf_counter()

        def late() -> bool:
            return time.perf_counter() - began >= seconds

        def sweeps_gain() -> bool:
            for _ in range(_SWEEPS):
                gain = self._sweep(late)
                if on_progress is not None:
                    on_progress(time.perf_counter() - began, float(self.values[0]))
                if late() or gain <= _GAIN * np.abs(self.values).max():
                    return False
            return True

        idle = 0
        while not late() and idle < _IDLE_ROUNDS:
            gained = sweeps_gain()
            grown = self._expand(late)
            idle = 0 if gained or grown else idle + 1

    def _keep(self, vectors: FloatArray, actions: IntArray) -> None:
        self.vectors, self.actions = vectors, actions
        self.columns = np.ascontiguousarray(vectors.T)
        self._score()

    def _score(self) -> None:
        scores = np.asarray(self.beliefs @ self.columns)
        self.best = scores.argmax(axis=1)
        self.values = scores.max(axis=1)

    def _belief(self, k: int) -> SparseBelief:
        entries = slice(self.beliefs.indptr[k], self.beliefs.indptr[k + 1])
        return self.beliefs.indices[entries].astype(np.int64), self.beliefs.data[entries]

    def _sweep(self, late: Callable[[], bool]) -> float:
        """Improve the value of every belief, or keep it; return the largest gain."""
        old = self.values
        values = np.full(old.size, -np.inf)
        vectors: list[FloatArray] = []
        actions: list[int] = []
        todo = np.arange(old.size)
        while todo.size and not late():
            k = int(self.random.choice(todo))
            vector, action = point_backup(self.rows, self.discount, *self._belief(k), self.columns)
            scores = self.beliefs @ vector
            if scores[k] <= old[k]:
                vector, action = self.vectors[self.best[k]], int(self.actions[self.best[k]])
                scores = self.beliefs @ vector
                scores[k] = old[k]  # the same, but for the order of the sum
            vectors.append(vector)
            actions.append(action)
            values = np.maximum(values, scores)
            todo = todo[values[todo] < old[todo]]
        left = np.unique(self.best[todo])  # the time is over
        self._keep(
            np.array([*vectors, *self.vectors[left]]),
            np.array([*actions, *self.actions[left]], dtype=np.int64),
        )
        return float((self.values - old).max())

    def _expand(self, late: Callable[[], bool]) -> bool:
        """Add beliefs; return whether there were any."""
        known = self.beliefs.shape[0]
        room = min(_NEW_BELIEFS, known, MAX_BELIEFS - known)
        for belief in (*self._far_successors((room + 1) // 2), *self._trajectory(room // 2)):
            if late():
                break
            if self._distance(belief) > _NOVEL:
                self.beliefs = csr_array(vstack([self.beliefs, csr_array(belief[None])]))
        self._score()
        return bool(self.beliefs.shape[0] > known)

    def _far_successors(self, count: int) -> Iterator[FloatArray]:
        """PBVI's rule: of one successor for each action, the one farthest from all beliefs."""
        for k in self.random.choice(self.beliefs.shape[0], size=count, replace=False):
            found = [self._successor(self._belief(k), a) for a in range(self.model.n_actions)]
            yield max(found, key=self._distance)

    def _trajectory(self, steps: int) -> Iterator[FloatArray]:
        """Episodes of the policy so far, with some random actions."""
        belief = self.model.start
        for _ in range(steps):
            action = int(self.actions[np.argmax(self.vectors @ belief)])
            if self.random.random() < _EXPLORATION:
                action = int(self.random.integers(self.model.n_actions))
            states = np.flatnonzero(belief)
            belief = self._successor((states, belief[states]), action)
            if belief.any():
                yield belief
            else:
                belief = self.model.start

    def _successor(self, belief: SparseBelief, action: int) -> FloatArray:
        """Return a possible next belief (S,); zeros after the episode's end."""
        uniform = self.random.random()
        after: FloatArray = sample_successor(
            self.rows, self.model.terminal, action, *belief, uniform
        )
        after[after < _NEGLIGIBLE] = 0.0
        return after / (after.sum() or 1.0)

    def _distance(self, belief: FloatArray) -> float:
        """L1 distance to the nearest known belief; 0 of what is none."""
        if not belief.any():
            return 0.0
        known = self.beliefs
        there = belief[known.indices]
        excess = np.abs(known.data - there) - there  # |b - b'| - b', summed where b > 0
        return float(1.0 + np.add.reduceat(excess, known.indptr[:-1]).min())
