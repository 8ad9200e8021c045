"""Native batches of every Gymnasium environment against SyncVectorEnv of the same environment.

`python -m baselines.benchmarks.batches` prints the table and exits 1 on a miss.
"""

from __future__ import annotations

import argparse
import sys

import gymnasium as gym

import bnprl_envs
from baselines.benchmarks.contest import Contest, run_contests
from baselines.benchmarks.throughput import batch_steps

COPIES, PEER_COPIES = 1024, 64
WANTED = 30.0


def native_contest(id: str) -> Contest:
    """Return the contest of one environment: its native batch, and its scalar form in a loop."""
    native = gym.make_vec(id, num_envs=COPIES)
    sync = gym.make_vec(id, num_envs=PEER_COPIES, vectorization_mode="sync")
    return Contest(
        f"{COPIES:,} copies of {id} / SyncVectorEnv of {PEER_COPIES}",
        batch_steps(native, calls=20),
        batch_steps(sync, calls=5),
        WANTED,
    )


def native_contests() -> list[Contest]:
    """Return one contest for every environment of one agent."""
    kinds = {id: bnprl_envs.entry(id).kind for id in bnprl_envs.environment_ids()}
    return [native_contest(id) for id, kind in kinds.items() if not kind.startswith("parallel")]


def main(arguments: list[str] | None = None) -> int:
    """Run every contest; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="for each side of a contest")
    seconds = parser.parse_args(arguments).seconds
    return 0 if run_contests(native_contests(), seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
