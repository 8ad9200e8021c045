"""A tabular model as a simulator of decision tables."""

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
from bnprl_agents.search.simulator import CUT, OVER, UInt64Array
from bnprl_agents.search.tables import DecisionTables
from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw
from bnprl_envs.tabular_parallel import observation_parts, space_sizes, strides


class TabularSimulator(CompiledSimulator):
    """Simulates a `TabularModel` and shows returns and visits alone; see `TeamSimulator`.

    Args:
        model: what is simulated; only its sampler is used.
        discount: factor in (0, 1].
        max_episode_steps: of an episode, at least 1.
    """

    def __init__(self, model: TabularModel, *, discount: float, max_episode_steps: int) -> None:
        super().__init__(
            model.action_sizes,
            space_sizes(model),
            discount=discount,
            max_episode_steps=max_episode_steps,
        )
        self._sampler = model.sampler
        self._strides = strides(model.action_sizes)
        self._parts = observation_parts(model).astype(np.int32)

    def _simulate(
        self, teams: DecisionTables, seeds: UInt64Array, returns: FloatArray, record: Record
    ) -> int:
        steps: int = _simulate(
            self._sampler,
            self._strides,
            self._parts,
            teams,
            seeds,
            self.horizon,
            self.discount,
            returns,
            record,
        )
        return steps


@njit(cache=True, nogil=True, error_model="numpy")
def _simulate(  # type: ignore[no-untyped-def]
    sampler, strides, parts, teams, seeds, horizon, discount, returns, record
):
    roles, action, successor = teams
    start = action.shape[2]
    rewards_seen = sampler.reward.shape[1] > 1
    counting = record.visits.size > 0
    explorer, choice = record.explorer, 0
    node = np.zeros(roles.size, dtype=np.uint32)
    steps = 0
    for b in range(returns.shape[0]):
        for e in range(returns.shape[1]):
            x = seeds[e]
            first = draw(sampler.start, 0, (hashed(x) >> np.uint64(32)) * UNIT)
            state = np.uint32(sampler.start.outcome[first])
            sight = state if sampler.informative_start else np.uint32(sampler.n_observations)
            node[:] = start
            factor = 1.0
            for t in range(horizon):
                joint = 0
                for n in range(roles.size):
                    role, seen = roles[n], parts[sight, n]
                    if counting:
                        record.visits[role, node[n], seen] += factor
                    node[n] = successor[b, role, node[n], seen]
                    chosen = action[b, role, node[n]]
                    if n == explorer:
                        chosen = choice = explored(
                            x, record.exploration, chosen, record.earned.shape[1]
                        )
                    joint += chosen * strides[n]
                row = joint * sampler.n_states
                x += GOLDEN
                bits = hashed(x)
                move = draw(sampler.transition, row + state, (bits >> np.uint64(32)) * UNIT)
                state = np.uint32(sampler.transition.outcome[move])
                low = (bits & np.uint64(0xFFFFFFFF)) * UNIT
                sight = np.uint32(
                    sampler.observation.outcome[draw(sampler.observation, row + state, low)]
                )
                reward = sampler.reward[move, sight if rewards_seen else 0]
                returns[b, e] += factor * reward
                over = sampler.terminal[state]
                if explorer >= 0:
                    what = OVER if over else parts[sight, explorer]
                    if t == horizon - 1:
                        what = CUT
                    record.followed[node[explorer], choice, what] += 1
                    record.earned[node[explorer], choice] += reward
                factor *= discount
                steps += 1
                if over:
                    break
    return steps
