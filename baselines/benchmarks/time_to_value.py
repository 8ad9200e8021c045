"""Environment steps and processor seconds until a policy is good, beside deep learners.

`python -m baselines.benchmarks.time_to_value --out records.jsonl` trains the strong learner of
POMDPs, RecurrentPPO and PPO in one run on seven environments, about an hour in all, with `--jobs`
several at a time, and prints when each first goes 80%, 90% and 95% of the way from random play to
the best known value: the median over the seeds, if more than half of them get there. (Shares of the
best known value itself would say nothing where random play earns 84% of it, or where it is
negative.) Every finished run is a line of the file, and is not run again. Values are means over
simulated episodes, never those of training; the seconds are those of learning alone, after
compilation, on one core each.

On Hallway a second table holds the strong learner against RecurrentPPO at every budget. It passes
where the strong learner's mean value reaches the other's within the same budget, in a tenth of its
seconds; the command exits 1 where it does not.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
from tqdm import tqdm

from baselines.benchmarks.pomdp_learners import AGENT, Goal, run
from baselines.benchmarks.run_records import Records, Run, Score
from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner
from bnprl_envs import registry

RIVAL = "recurrent-ppo"
AGENTS = (AGENT, RIVAL, "ppo")
RACE = "bnprl/Hallway-v0"
"""Where `AGENT` must reach what `RIVAL` has at every budget, `FASTER` times as fast."""
FASTER = 10.0
BUDGETS = {
    "bnprl/CheeseMaze-v0": 150_000,
    "bnprl/Grid4x4-v0": 150_000,
    "bnprl/NoisyMaze1D-v0": 150_000,
    "bnprl/Shuttle-v0": 150_000,
    RACE: 450_000,
    "bnprl/Hallway2-v0": 150_000,
    "bnprl/Tag-v0": 150_000,
}
"""Environment steps of a run."""
SHARES = (0.80, 0.90, 0.95)
POINTS = 10
"""Evaluations of a run, at steps in a geometric series whose last is the budget."""
FIRST_SHARE = 0.04
"""Of the budget, at the first evaluation."""
SOONER = 5
"""Evaluations of our learners before that, in the same series."""
EVALUATION_EPISODES = 1_000


def curve(name: str, env: str, seed: int, steps: int, *, shown: bool = False) -> list[Score]:
    """Train a contender from one seed and score it at every point.

    Our learners are scored by the last policy that they learned within each point. Deep learners
    change their policy in place, and are scored at the first update after it, with more steps.

    Args:
        name: of the contender.
        env: id of an environment.
        seed: of everything random.
        steps: budget.
        shown: whether to draw a progress bar.

    Raises:
        ValueError: the contender is one of ours that is no learner of POMDPs.
    """
    if contender(name).family != "bnprl":
        return deep_curve(name, env, seed, points(steps, POINTS), shown=shown)
    for _ in build_learner(contender(name), EnvironmentSpec(env), None, seed).learn(episodes=8):
        pass  # compiles
    goals = [Goal(point, -np.inf) for point in points(steps, SOONER + POINTS)]
    return run(name, env, seed, goals=goals, episodes=EVALUATION_EPISODES, shown=shown)


def points(steps: int, number: int) -> list[int]:
    """The steps at which a run is scored; the last is the budget."""
    back = np.arange(number - 1, -1, -1) / (POINTS - 1)
    found: list[int] = (steps * FIRST_SHARE**back).round().astype(int).tolist()
    return found


def deep_curve(
    name: str, env: str, seed: int, waiting: list[int], *, shown: bool = False
) -> list[Score]:
    """Train a deep learner; score it at the first update after each point, and at the end."""
    spec, scores, steps = EnvironmentSpec(env), list[Score](), waiting[-1]
    learner = build_learner(contender(name), spec, None, seed)
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
            if taken >= waiting[0]:
                score()
                waiting = [point for point in waiting if point > taken]
                if not waiting:
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


def race(runs: dict[str, list[list[Score]]]) -> bool:
    """Print where the strong learner first reaches what its rival has at every budget.

    Returns:
        Whether it always does, within the budget and `FASTER` times as fast.
    """
    print(f"\n{RACE:21}  {RIVAL:>33}  {AGENT:>33}")
    print(f"{'':21}" + f"  {'steps':>13}  {'mean':>8}  {'cpu s':>8}" * 2 + f"  {'ratio':>6}")
    passed = True
    ours, theirs = (
        np.mean([[score[:3] for score in scores] for scores in runs[name]], axis=0)
        for name in (AGENT, RIVAL)
    )
    for rival in theirs:
        within = ours[ours[:, 0] <= rival[0]]
        first = next((score for score in within if score[1] >= rival[1]), within[-1])
        ratio = rival[2] / max(first[2], 1e-9)
        won = bool(first[1] >= rival[1] and ratio >= FASTER)
        passed &= won
        sides = "".join(f"  {n:13,.0f}  {v:8.4f}  {s:8.1f}" for n, v, s in (rival, first))
        print(f"{'':21}{sides}  {ratio:6.1f}  {'pass' if won else 'FAIL'}", flush=True)
    print()
    return passed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every seed of every contender on every environment; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", nargs="+", default=AGENTS, help="names of contenders")
    parser.add_argument("--seeds", type=int, default=3, help="runs on each environment")
    parser.add_argument("--steps", type=int, help="budget of every run, else each environment's")
    parser.add_argument("--environments", nargs="+", choices=list(BUDGETS), default=list(BUDGETS))
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    parser.add_argument("--out", type=Path, help="file of finished runs, which are not run again")
    parser.add_argument("--no-progress", action="store_true", help="draw no progress bars")
    options = parser.parse_args(arguments)
    for name in ("seeds", "steps", "jobs"):
        if getattr(options, name) is not None and getattr(options, name) < 1:
            parser.error(f"--{name}: {getattr(options, name)}, must be at least 1")
    records, passed, shown = Records(options.out), True, not options.no_progress
    runs = {
        env: {
            name: [
                described(name, env, seed, options.steps or BUDGETS[env], shown=shown)
                for seed in range(options.seeds)
            ]
            for name in options.agents
        }
        for env in options.environments
    }
    if options.jobs > 1:
        longest = sorted(runs, key=BUDGETS.__getitem__, reverse=True)
        every = chain(*(seeds for env in longest for seeds in runs[env].values()))
        records.prepare(list(every), options.jobs, shown=shown)
    print(HEADER)
    for env, contenders in runs.items():
        curves = {name: [records.of(run) for run in seeds] for name, seeds in contenders.items()}
        report(env, curves)
        if env == RACE and {AGENT, RIVAL} <= set(curves):
            passed &= race(curves)
    return 0 if passed else 1


def described(name: str, env: str, seed: int, steps: int, *, shown: bool) -> Run:
    """A run of `curve`."""
    make = partial(curve, name, env, seed, steps, shown=shown)
    return Run.of(name, env, seed, make, steps=steps)


if __name__ == "__main__":
    sys.exit(main())
