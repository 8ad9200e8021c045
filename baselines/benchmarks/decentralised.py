"""Batches of the decentralised environments against a Python loop over as many copies.

`python -m baselines.benchmarks.decentralised` prints the table and exits 1 on a miss. The last two
contests hold a large traffic grid against a small one: its steps of one agent must cost no more
than 1.5 times as much.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

import bnprl_envs
from baselines.benchmarks.contest import Contest, run_contests
from bnprl_envs import GridTraffic, GridTrafficBatch, TabularParallelBatch, TabularParallelEnv

COPIES = 1024
WANTED = 30.0
GROWTH = 1.5
"""Largest ratio of the costs of one agent's step, large grid to small grid."""
SMALL, LARGE = 10, 100
"""Rows and columns of the two grids."""


def batch_steps(
    batch: VectorEnv[Any, Any, Any], n_actions: list[int], calls: int
) -> Callable[[], float]:
    """Return work: some steps of a batch, in steps of one copy, under random actions."""
    rng = np.random.default_rng(0)
    actions = rng.integers(n_actions, size=(calls, batch.num_envs, len(n_actions)))
    batch.reset(seed=0)

    def work() -> float:
        for chosen in actions:
            batch.step(chosen)
        return calls * batch.num_envs

    return work


def looped_steps(envs: list[Any], n_actions: list[int]) -> Callable[[], float]:
    """Return work: one step of each of some parallel environments, under random actions."""
    rng = np.random.default_rng(0)
    actions = [
        dict(zip(env.possible_agents, rng.integers(n_actions).tolist(), strict=True))
        for env in envs
    ]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)

    def work() -> float:
        for env, chosen in zip(envs, actions, strict=True):
            env.step(chosen)
        return len(envs)

    return work


def per_agent(work: Callable[[], float], n_agents: int) -> Callable[[], float]:
    """Return the same work, counted in steps of one agent."""
    return lambda: n_agents * work()


def tabular_contest(id: str) -> Contest:
    """Return the contest of one tabular environment."""
    n_actions = list(bnprl_envs.model(id).action_sizes)
    return Contest(
        f"{COPIES:,} copies of {id}: batch / Python loop",
        batch_steps(TabularParallelBatch(id, COPIES), n_actions, calls=20),
        looped_steps([TabularParallelEnv(id) for _ in range(COPIES)], n_actions),
        WANTED,
    )


def traffic_contests() -> list[Contest]:
    """Return the contests of grid traffic: batch against loop, and large grid against small."""

    def batch(side: int, copies: int, calls: int) -> Callable[[], float]:
        envs = GridTrafficBatch(copies, rows=side, columns=side, max_episode_steps=None)
        return batch_steps(envs, [2] * side**2, calls)

    def loop(side: int, copies: int) -> Callable[[], float]:
        envs = [GridTraffic(rows=side, columns=side, max_cycles=None) for _ in range(copies)]
        return looped_steps(envs, [2] * side**2)

    def sides(name: str, large: Callable[[], float], small: Callable[[], float]) -> Contest:
        return Contest(
            f"traffic {name}, {LARGE} x {LARGE} / {SMALL} x {SMALL}",
            per_agent(large, LARGE**2),
            per_agent(small, SMALL**2),
            1.0 / GROWTH,
            "agent steps",
        )

    return [
        Contest(
            f"{COPIES:,} copies of bnprl/GridTraffic-v0: batch / Python loop",
            batch(SMALL, COPIES, calls=5),
            loop(SMALL, COPIES),
            WANTED,
        ),
        sides("environment", loop(LARGE, 1), loop(SMALL, 1)),
        sides("batch of 16", batch(LARGE, 16, calls=5), batch(SMALL, 16, calls=100)),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Run every contest; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="for each side of a contest")
    seconds = parser.parse_args(arguments).seconds
    ids = [
        id for id in bnprl_envs.environment_ids() if bnprl_envs.entry(id).kind == "parallel-tabular"
    ]
    contests = [*map(tabular_contest, ids), *traffic_contests()]
    return 0 if run_contests(contests, seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
