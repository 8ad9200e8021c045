"""Steps per second of our environments against Gymnasium's.

`python -m baselines.benchmarks.throughput` prints the table and exits 1 on a miss.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym

import bnprl_envs  # noqa: F401 (registers its ids)
from baselines.benchmarks.contest import Contest, run_contests

OURS, PEER = "bnprl/Hallway-v0", "FrozenLake-v1"


def scalar_steps(env: gym.Env[Any, Any], steps: int = 2000) -> Callable[[], float]:
    """Return work: some steps of one environment under random actions drawn beforehand."""
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(steps)]
    env.reset(seed=0)

    def work() -> float:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    return work


def batch_steps(envs: gym.vector.VectorEnv[Any, Any, Any], calls: int) -> Callable[[], float]:
    """Return work: some steps of a batch under random actions drawn beforehand."""
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(calls)]
    envs.reset(seed=0)

    def work() -> float:
        for action in actions:
            envs.step(action)
        return calls * envs.num_envs

    return work


def environment_contests() -> list[Contest]:
    """Return the contests of environments, scalar and batched."""
    lakes = gym.make_vec(PEER, num_envs=64, vectorization_mode="sync")
    peer = batch_steps(lakes, calls=5)
    return [
        Contest(
            f"gym.make: {OURS} / {PEER}",
            scalar_steps(gym.make(OURS)),
            scalar_steps(gym.make(PEER)),
            wanted=2.5,
        ),
        Contest(
            f"unwrapped: {OURS} / {PEER}",
            scalar_steps(gym.make(OURS).unwrapped),
            scalar_steps(gym.make(PEER).unwrapped),
            wanted=2.5,
        ),
        *(
            Contest(
                f"{copies:,} copies of {OURS} / SyncVectorEnv of 64 {PEER}",
                batch_steps(gym.make_vec(OURS, num_envs=copies), calls=20),
                peer,
                wanted,
            )
            for copies, wanted in ((1024, 100.0), (16384, 300.0))
        ),
    ]


CONTESTS: tuple[Callable[[], list[Contest]], ...] = (environment_contests,)
"""Makers of contests, in the order of the table: add one here."""


def main(arguments: list[str] | None = None) -> int:
    """Run every contest; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="for each side of a contest")
    seconds = parser.parse_args(arguments).seconds
    return 0 if run_contests([c for make in CONTESTS for c in make()], seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
