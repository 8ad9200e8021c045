"""Policies without memory: what each agent does depends on its own last observation alone.

The first action follows the null observation, which is the last entry of a policy.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bnprl_envs.model import TabularModel
from bnprl_envs.planning import infinite_horizon_discount
from bnprl_envs.sensor_chain import sensor_chain, solve_chain
from bnprl_envs.tables import FloatArray

IntArray = npt.NDArray[np.int64]
Progress = Callable[[float, float], None]
"""Called with the seconds used and the best value so far."""

_ENOUGH = 10
"""Restarts for each policy that there is, after which no better one is expected."""


class JointPolicy(NamedTuple):
    """A deterministic memoryless joint policy.

    Attributes:
        policies: for each agent, its action after each of its own observations, and last the
            first action.
        value: at the start, exactly.
    """

    policies: list[list[int]]
    value: float


def memoryless_value(
    model: TabularModel,
    policies: Sequence[Sequence[int] | npt.NDArray[Any]],
    discount: float | None = None,
) -> float:
    """Return the exact value of a memoryless joint policy at the start, by one linear system.

    Args:
        model: partially observed; one agent or many.
        policies: for each agent i, (O_i + 1,) actions or (O_i + 1, A_i) action probabilities.
        discount: instead of the model's.

    Raises:
        ValueError: the policies do not fit the model, the model is fully observed or the
            discount not below 1.
    """
    chosen = infinite_horizon_discount(model, discount)
    if len(policies) != model.n_agents:
        raise ValueError(f"policies: {len(policies)} of them, must be one for each agent")
    tables = [policy_table(model, agent, policy) for agent, policy in enumerate(policies)]
    return solve_chain(sensor_chain(model), _joint_table(tables), chosen).value


def memoryless_joint_policy(
    model: TabularModel,
    *,
    restarts: int | None = 100,
    seconds: float | None = None,
    seed: int = 0,
    discount: float | None = None,
    on_progress: Progress | None = None,
) -> JointPolicy:
    """Search the best deterministic memoryless joint policy.

    Coordinate ascent on the exact value: one agent's action after one observation at a time is
    set to the best one until nothing improves; begun again from random policies, and every other
    time from the best ones so far with a fifth of their actions redrawn (iterated local search;
    Lourenço, Martin and Stützle 2003). The best of the restarts is a lower bound of the best
    there is.

    It is over, too, when the restarts outnumber the policies that there are by ten to one.

    Args:
        model: partially observed; one agent or many.
        restarts: how often to begin; None: until the time is over.
        seconds: time to spend; None: until the restarts are done.
        seed: of the random policies; the result depends on it and on the restarts made.
        discount: instead of the model's.
        on_progress: called after every restart.

    Returns:
        The policies and their value, which unpack as a pair.

    Raises:
        ValueError: no limit is given or one is out of range, the model is fully observed or the
            discount not below 1.
    """
    from bnprl_envs.coordinate_ascent import Ascent  # numba: imported where it is needed

    chosen = infinite_horizon_discount(model, discount)
    check_limits(restarts, seconds)
    chain = sensor_chain(model)
    ascent = Ascent(chain, model.action_sizes, model.observation_sizes, chosen)
    random = np.random.default_rng(seed)
    best, policies = ascent.restart(random, late=lambda: True)  # compiles it
    clock = Clock(seconds, on_progress)
    enough = _ENOUGH * math.prod(ascent.tables.choices.tolist())
    for restart in itertools.count():
        if restart in (restarts, enough) or (restart and clock.late()):
            break
        value, found = ascent.restart(random, clock.late, near=policies if restart % 2 else None)
        if value > best:
            best, policies = value, found
        clock.report(best)
    lists = ascent.as_lists(policies)
    return JointPolicy(lists, memoryless_value(model, lists, chosen))


def policy_table(
    model: TabularModel, agent: int, policy: Sequence[int] | npt.NDArray[Any]
) -> FloatArray:
    """Return one agent's action probabilities (O_i + 1, A_i).

    Raises:
        ValueError: it is no policy of that agent.
    """
    rows, columns = model.observation_sizes[agent] + 1, model.action_sizes[agent]
    given = np.asarray(policy)
    if given.shape == (rows,) and given.dtype.kind in "iu":
        if not ((given >= 0) & (given < columns)).all():
            raise ValueError(f"policies: agent {agent} has actions outside [0, {columns})")
        table: FloatArray = np.eye(columns)[given]
        return table
    if given.shape != (rows, columns):
        raise ValueError(
            f"policies: agent {agent} has shape {given.shape}, "
            f"must be {(rows,)} of integers or {(rows, columns)}"
        )
    table = given.astype(np.float64)
    if not ((table >= 0).all() and np.allclose(table.sum(axis=1), 1.0, rtol=0, atol=1e-9)):
        raise ValueError(f"policies: agent {agent} has a row that is no distribution")
    return table


def _joint_table(tables: Sequence[FloatArray]) -> FloatArray:
    """Return joint action probabilities (O + 1, A): null only where everybody has seen nothing."""
    after: FloatArray = np.ones((1, 1))
    first: FloatArray = np.ones((1, 1))
    for table in tables:
        after = np.asarray(np.kron(after, table[:-1]), dtype=np.float64)
        first = np.asarray(np.kron(first, table[-1:]), dtype=np.float64)
    return np.vstack([after, first])


def check_limits(restarts: int | None, seconds: float | None) -> None:
    """Check what ends a search.

    Raises:
        ValueError: nothing does, or a limit is out of range.
    """
    if restarts is None and seconds is None:
        raise ValueError("restarts: None, must be an int unless seconds are given")
    if restarts is not None and restarts < 1:
        raise ValueError(f"restarts: {restarts}, must be at least 1")
    if seconds is not None and not seconds > 0:
        raise ValueError(f"seconds: {seconds}, must be over 0")


class Clock:
    """The time a search has, and whom it tells."""

    def __init__(self, seconds: float | None, on_progress: Progress | None) -> None:
        self.seconds, self.on_progress = seconds, on_progress
        self.began = time.perf_counter()

    def late(self) -> bool:
        """Whether the time is over."""
        return self.seconds is not None and time.perf_counter() - self.began >= self.seconds

    def report(self, value: float) -> None:
        """Tell the best value so far."""
        if self.on_progress is not None:
            self.on_progress(time.perf_counter() - self.began, value)
