"""Environment steps and processor seconds until a policy is good, beside deep learners.

`python -m baselines.benchmarks.time_to_value --out records.jsonl` trains the strong learner of
POMDPs, RecurrentPPO and PPO in one run on seven environments, about an hour in all, and prints when
each first goes 80%, 90% and 95% of the way from random play to the best known value: the median
over the seeds, if more than half of them get there. (Shares of the best known value itself would
say nothing where random play earns 84% of it, or where it is negative.) Every finished run is a
line of the file, and is not run again. Values are means over simulated episodes, never those of
training; the seconds are those of learning alone, after compilation, on one core each.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from baselines.benchmarks.run_records import Records, Score
from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner
from bnprl_envs import registry

AGENTS = ("predictive-actor-critic", "recurrent-ppo", "ppo")
ENVIRONMENTS = tuple(
    f"bnprl/{name}-v0"
    for name in ("CheeseMaze", "Grid4x4", "NoisyMaze1D", "Shuttle", "Hallway", "Hallway2", "Tag")
)
SHARES = (0.80, 0.90, 0.95)
POINTS = 10
"""Evaluations of a run, at steps in a geometric series whose last is the budget."""
FIRST_SHARE = 0.04
"""Of the budget, at the first evaluation."""
EVALUATION_EPISODES = 1_000


def curve(name: str, env: str, seed: int, steps: int, *, shown: bool = False) -> list[Score]:
    """Train a contender from one seed; score it at the first update after each point.

    Args:
        name: of the contender.
        env: id of an environment.
        seed: of everything random.
        steps: budget.
        shown: whether to draw a progress bar.
    """
    spec, scores = EnvironmentSpec(env), list[Score]()
    if contender(name).family == "bnprl":
        for _ in build_learner(contender(name), spec, None, seed).learn(episodes=8):
            pass  # compiles
    learner = build_learner(contender(name), spec, None, seed)
    points = np.geomspace(FIRST_SHARE * steps, steps, POINTS).tolist()
    begin, scoring, taken = time.process_time(), 0.0, 0

    def score() -> None:
        nonlocal scoring
        stopped = time.process_time()
        found = evaluate(learner.policy, spec, episodes=EVALUATION_EPISODES, seed=seed)
        scores.append(Score(taken, float(found.returns.mean()), stopped - begin - scoring))
        scoring += time.process_time() - stopped

    with tqdm(total=steps, desc=f"{name} {env} {seed}", disable=not shown, delay=2) as bar:
        for now in learner.learn(steps=steps):
            taken = now.steps
            bar.update(taken - bar.n)
            if taken >= points[0]:
                score()
                points = [point for point in points if point > taken]
                if not points:
                    return scores
        score()
    return scores


def thresholds(env: str) -> list[float]:
    """The values at the `SHARES` of the way from random play to the best known one."""
    known = {reference.name: reference.value for reference in registry.entry(env).references}
    return [known["random"] + share * (known["lower"] - known["random"]) for share in SHARES]


def reached(scores: Sequence[Score], value: float) -> Score | None:
    """The first score of at least a value."""
    return next((score for score in scores if score.value >= value), None)


def typical(runs: Sequence[Sequence[Score]], value: float) -> tuple[float, float]:
    """Median steps and seconds until a value is reached; infinite where half the runs never do."""
    found = [reached(scores, value) for scores in runs]
    when = [(score.steps, score.seconds) if score else (np.inf, np.inf) for score in found]
    steps, seconds = np.median(when, axis=0)
    return float(steps), float(seconds)


def report(env: str, runs: dict[str, list[list[Score]]]) -> None:
    """Print a line for every share and contender of an environment."""
    for share, value in zip(SHARES, thresholds(env), strict=True):
        for name, curves in runs.items():
            steps, seconds = typical(curves, value)
            got = sum(reached(scores, value) is not None for scores in curves)
            when = f"{steps:11,.0f}  {seconds:8.1f}" if np.isfinite(steps) else f"{'never':>21}"
            last = np.mean([scores[-1].value for scores in curves])
            print(
                f"{env:21}  {share:4.0%}  {value:9.4f}  {name:23}  {when}  "
                f"{got:3}/{len(curves)}  {last:10.4f}",
                flush=True,
            )


HEADER = (
    f"{'environment':21}  {'':>4}  {'value':>9}  {'contender':23}  {'steps':>11}  {'cpu s':>8}  "
    f"{'seeds':>5}  {'at the end':>10}"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every seed of every contender on every environment; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", nargs="+", default=AGENTS, help="names of contenders")
    parser.add_argument("--seeds", type=int, default=3, help="runs on each environment")
    parser.add_argument("--steps", type=int, default=150_000, help="budget of a run")
    parser.add_argument("--environments", nargs="+", choices=ENVIRONMENTS, default=ENVIRONMENTS)
    parser.add_argument("--out", type=Path, help="file of finished runs, which are not run again")
    parser.add_argument("--no-progress", action="store_true", help="draw no progress bars")
    options = parser.parse_args(arguments)
    for name in ("seeds", "steps"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: {getattr(options, name)}, must be at least 1")
    records, shown = Records(options.out), not options.no_progress
    print(HEADER)
    for env in options.environments:
        runs: dict[str, list[list[Score]]] = {name: [] for name in options.agents}
        for name, curves in runs.items():
            for seed in range(options.seeds):
                described = {
                    "agent": name,
                    "settings": dataclasses.asdict(contender(name).settings),
                    "environment": env,
                    "seed": seed,
                    "steps": options.steps,
                }
                make = functools.partial(curve, name, env, seed, options.steps, shown=shown)
                curves.append(records.of(described, make))
        report(env, runs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
