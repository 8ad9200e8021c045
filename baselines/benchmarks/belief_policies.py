"""What the actor-critic on a learned belief reaches on the POMDPs, for the steps spent.

`python -m baselines.benchmarks.belief_policies` trains several seeds on every environment with the
default settings and prints steps, processor seconds and mean returns against the wanted ones; it
exits 1 where a mean over the seeds falls short. Returns are simulated, never those of training.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from baselines.contenders import build_learner, contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate

NAME = "predictive-actor-critic"
EVALUATION_EPISODES = 4_000
GOALS = {
    "bnprl/Hallway-v0": {150_000: 0.444, 300_000: 0.459, 450_000: 0.477, 1_500_000: 0.50},
    "bnprl/Hallway2-v0": {1_000_000: 0.2061},
    "bnprl/Tag-v0": {1_000_000: -12.5, 5_000_000: -8.0},
    "bnprl/CheeseMaze-v0": {1_000_000: 0.80},
    "bnprl/Grid4x4-v0": {1_000_000: 0.82},
    "bnprl/NoisyMaze1D-v0": {1_000_000: 0.71},
    "bnprl/Shuttle-v0": {1_000_000: 31.0},
}
"""Wanted mean return after so many steps. Hallway up to 450,000: a well-set RecurrentPPO; Tag's
first: a memoryless PPO after 400,000; Hallway2: the best memoryless policy."""


class Score(NamedTuple):
    """How one seed stands: environment steps, mean return, processor seconds of training."""

    steps: int
    value: float
    seconds: float


def run(env: str, seed: int, goals: Sequence[int], shown: bool = False) -> list[Score]:
    """Train from one seed and evaluate the policy after each number of steps.

    Args:
        env: id of an environment.
        seed: of everything random.
        goals: numbers of steps, rising.
        shown: whether to draw a progress bar.
    """
    spec = EnvironmentSpec(env)
    learner = build_learner(contender(NAME), spec, None, seed)
    waiting, scores, last = list(goals), [], 0
    scoring, begin = 0.0, time.process_time()

    def score(steps: int) -> None:
        nonlocal scoring
        pause = time.process_time()
        found = evaluate(learner.policy, spec, episodes=EVALUATION_EPISODES, seed=seed)
        scores.append(Score(steps, float(found.returns.mean()), pause - begin - scoring))
        scoring += time.process_time() - pause
        waiting.pop(0)

    with tqdm(total=goals[-1], desc=f"{env} {seed}", disable=not shown, delay=2) as bar:
        for now in learner.learn(steps=goals[-1]):
            bar.update(now.steps - last)
            last = now.steps
            if waiting[1:] and last >= waiting[0]:
                score(last)
    while waiting:
        score(last)
    return scores


def report(env: str, runs: Sequence[Sequence[Score]]) -> bool:
    """Print a line for every goal of an environment; return whether all are reached."""
    passed = True
    for wanted, scores in zip(GOALS[env].values(), zip(*runs, strict=True), strict=True):
        values = np.array([score.value for score in scores])
        reached = bool(values.mean() >= wanted)
        passed &= reached
        print(
            f"{env:20}  {np.mean([s.steps for s in scores]):10,.0f}  "
            f"{np.mean([s.seconds for s in scores]):7.1f}  {values.mean():8.4f}  "
            f"{values.min():8.4f}  {values.max():8.4f}  {wanted:8.4f}  "
            f"{'pass' if reached else 'FAIL'}",
            flush=True,
        )
    return passed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every seed on every environment and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="runs on each environment")
    parser.add_argument("--environments", nargs="+", choices=list(GOALS), default=list(GOALS))
    parser.add_argument("--no-progress", action="store_true", help="draw no progress bars")
    options = parser.parse_args(arguments)
    print("environment                steps    cpu s      mean     least      most    wanted")
    passed = True
    for env in options.environments:
        runs = [
            run(env, seed, list(GOALS[env]), shown=not options.no_progress)
            for seed in range(options.seeds)
        ]
        passed &= report(env, runs)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
