"""What the EM learners reach on Hallway within 50,000 episodes, and how fast.

`python -m baselines.benchmarks.hallway` prints the table and exits 1 where fewer than 4 of 5 seeds
reach the wanted mean return within a minute, or where the exact value of a learned controller
lies outside the simulation's interval.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass

import numpy as np

from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0")
WANTED = {"online-em": 0.30, "batch-em": 0.36}
"""Smallest mean discounted return of a seed that counts."""
EPISODES, EVALUATION_EPISODES = 50_000, 2_000
SECONDS = 60.0
STANDARD_ERRORS = 3.3
"""Half-width of the simulation's interval: 99.9% each, since ten of them must hold at once."""


@dataclass(frozen=True)
class Run:
    """One seed: simulated mean and its standard error, exact value, steps and seconds."""

    mean: float
    error: float
    exact: float
    steps: int
    seconds: float


def run(name: str, seed: int, episodes: int = EPISODES) -> Run:
    """Train one learner from one seed and evaluate it."""
    begin = time.perf_counter()
    learner = build_learner(contender(name), HALLWAY, None, seed)
    *_, last = learner.learn(episodes=episodes)
    seconds = time.perf_counter() - begin
    found = evaluate(learner.policy, HALLWAY, episodes=EVALUATION_EPISODES, seed=seed)
    assert found.exact is not None
    error = float(found.returns.std(ddof=1) / np.sqrt(EVALUATION_EPISODES))
    return Run(float(found.returns.mean()), error, found.exact, last.steps, seconds)


def passes(name: str, runs: list[Run]) -> bool:
    """Whether 4 of 5 seeds reach the wanted return in time, and every value is confirmed."""
    reached = sum(r.mean >= WANTED[name] and r.seconds < SECONDS for r in runs)
    confirmed = all(abs(r.mean - r.exact) <= STANDARD_ERRORS * r.error for r in runs)
    return reached >= 0.8 * len(runs) and confirmed


def main() -> int:
    """Run every seed and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each learner")
    seeds = parser.parse_args().seeds
    passed = True
    print("learner    seed  simulated           exact   wanted  steps       seconds")
    for name in WANTED:
        runs = []
        for seed in range(seeds):
            r = run(name, seed)
            runs.append(r)
            print(
                f"{name:9}  {seed:4}  {r.mean:.4f} +- {STANDARD_ERRORS * r.error:.4f}  "
                f"{r.exact:.4f}  {WANTED[name]:.4f}  {r.steps:10,}  {r.seconds:7.1f}",
                flush=True,
            )
        passed &= passes(name, runs)
        print(f"{name}: {'pass' if passes(name, runs) else 'FAIL'}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
