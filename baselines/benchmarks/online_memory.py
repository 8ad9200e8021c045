"""Time and peak memory of the online learners as the number of episodes grows.

`python -m baselines.benchmarks.online_memory` trains each learner on 1,000 to 50,000 episodes of
Hallway, each in a process of its own, and exits 1 where the peak memory at the largest number
exceeds that at the smallest by more than a tenth, or the CPU time of an episode more than doubles.
iRPR begins with all the nodes that it has room for: a batch's messages take memory for every node.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import time
from typing import Any

from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.learners import build_learner

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0")
EPISODES = (1_000, 5_000, 20_000, 50_000)
SETTINGS: dict[str, dict[str, Any]] = {
    "online-em": {},
    "variational": {"schedule": "online", "batch_episodes": 100},
    "stick-breaking": {"schedule": "online", "batch_episodes": 100},
    "infinite-rpr": {
        "schedule": "online",
        "batch_episodes": 100,
        "outer_iterations": 1,
        "divisions": 1,
        "initial_nodes": 29,
    },
}
MEMORY, TIME = 1.1, 2.0
"""Largest ratios of peak memory and of an episode's time, most episodes to fewest."""


def measure(name: str, episodes: int) -> tuple[float, float]:
    """CPU seconds of learning and peak memory in MiB of this process."""
    entry = contender(name)
    settings = type(entry.settings)(**SETTINGS[name])
    for _ in build_learner(entry, HALLWAY, settings, 1).learn(episodes=300):
        pass  # compiles
    learner = build_learner(entry, HALLWAY, settings, 0)
    begin = time.process_time()
    for _ in learner.learn(episodes=episodes):
        pass
    seconds = time.process_time() - begin
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main(arguments: list[str] | None = None) -> int:
    """Measure every learner and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--episodes", nargs="+", type=int, default=list(EPISODES))
    options = parser.parse_args(arguments)
    context, passed = multiprocessing.get_context("spawn"), True
    print("learner         episodes  CPU ms an episode  peak MiB")
    for name in options.agents:
        found = []
        for episodes in options.episodes:
            with context.Pool(1) as pool:
                seconds, peak = pool.apply(measure, (name, episodes))
            found.append((seconds / episodes, peak))
            print(f"{name:14} {episodes:9,} {1e3 * found[-1][0]:18.3f} {peak:9.1f}", flush=True)
        passed &= found[-1][1] <= MEMORY * found[0][1] and found[-1][0] <= TIME * found[0][0]
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
