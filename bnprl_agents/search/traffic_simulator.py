"""Grid traffic as a simulator of decision tables."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.episodes import FloatArray
from bnprl_agents.search.compiled_simulator import (
    GOLDEN,
    UNIT,
    CompiledSimulator,
    Record,
    explored,
    hashed,
)
from bnprl_agents.search.simulator import CUT, UInt64Array
from bnprl_agents.search.tables import DecisionTables
from bnprl_envs.grid_traffic_batch import HORIZONTAL, GridTrafficBatch


class TrafficSimulator(CompiledSimulator):
    """Simulates the dynamics of a `GridTrafficBatch`; see `TeamSimulator`.

    Args:
        env: whose sizes and rates are used; it is not stepped.
        discount: factor in (0, 1].
        max_episode_steps: of an episode, at least 1.
    """

    def __init__(self, env: GridTrafficBatch, *, discount: float, max_episode_steps: int) -> None:
        super().__init__(
            (2,) * env.n_agents,
            ((env.capacity + 1) ** 2,) * env.n_agents,
            discount=discount,
            max_episode_steps=max_episode_steps,
        )
        self._sizes = (env.rows, env.columns, env.capacity, env.discharge)
        self._arrival_rate = env.arrival_rate

    def _simulate(
        self, teams: DecisionTables, seeds: UInt64Array, returns: FloatArray, record: Record
    ) -> int:
        _simulate(
            self._sizes,
            self._arrival_rate,
            teams,
            seeds,
            self.horizon,
            self.discount,
            returns,
            record,
        )
        return self.horizon * returns.size


@njit(cache=True, nogil=True, error_model="numpy")
def _simulate(  # type: ignore[no-untyped-def]
    sizes, arrival_rate, teams, seeds, horizon, discount, returns, record
):
    rows, columns, capacity, discharge = sizes
    node = np.empty(rows * columns, dtype=np.uint32)
    queues = np.empty(rows + columns, dtype=np.int64)
    opened = np.empty(rows + columns, dtype=np.bool_)
    for b in range(returns.shape[0]):
        for e in range(returns.shape[1]):
            x = seeds[e]
            queues[:] = 0
            node[:] = teams.action.shape[2]
            factor = 1.0
            for t in range(horizon):
                choice = _decide(teams, b, queues, rows, capacity, node, opened, factor, record, x)
                passed = 0
                for line in range(queues.size):
                    if opened[line]:
                        leaving = min(queues[line], discharge)
                        queues[line] -= leaving
                        passed += leaving
                    x += GOLDEN
                    arriving = (hashed(x) >> np.uint64(32)) * UNIT < arrival_rate
                    if arriving and queues[line] < capacity:
                        queues[line] += 1
                returns[b, e] += factor * passed
                if record.explorer >= 0:
                    what = _seen(queues, rows, capacity, record.explorer)
                    if t == horizon - 1:
                        what = CUT
                    record.followed[node[record.explorer], choice, what] += 1
                    record.earned[node[record.explorer], choice] += passed
                factor *= discount


@njit(cache=True, inline="always")
def _seen(queues, rows, capacity, n):  # type: ignore[no-untyped-def]
    """What an agent sees: the queues of its row and its column."""
    i, j = n // (queues.size - rows), n % (queues.size - rows)
    return queues[i] * (capacity + 1) + queues[rows + j]


@njit(cache=True, inline="always")
def _decide(  # type: ignore[no-untyped-def]
    teams, b, queues, rows, capacity, node, opened, factor, record, x
):
    """Move every agent's node by what it sees, and open the lines that all agree on.

    Returns the explorer's action.
    """
    columns, choice = queues.size - rows, 0
    opened[:] = True
    for n in range(node.size):
        i, j = n // columns, n % columns
        role, seen = teams.roles[n], _seen(queues, rows, capacity, n)
        if record.visits.size > 0:
            record.visits[role, node[n], seen] += factor
        node[n] = teams.successor[b, role, node[n], seen]
        action = teams.action[b, role, node[n]]
        if n == record.explorer:
            action = choice = explored(x, record.exploration, action, 2)
        if action == HORIZONTAL:
            opened[rows + j] = False
        else:
            opened[i] = False
    return choice
