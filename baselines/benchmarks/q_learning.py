"""What chapter 3 claims of GPQ, judged by the records of figure 3.2.

`bnprl reproduce figure-3.2 --out DIR` makes the records; `python -m baselines.benchmarks.q_learning
DIR` prints every claim and exits 1 where one fails. Without DIR it judges those that are kept in
the repository. A run reaches a goal at its first evaluation that does; one that never does counts
as later than every other. Medians are over the seeds, with a 95% bootstrap interval.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from baselines.records import Record
from baselines.report import Curves, finished_runs
from baselines.reproduction import Comparison, find
from baselines.study import read_runs
from bnprl_agents.episodes import FloatArray

KEPT = Path(__file__).parent.parent / "results" / "figure-3.2"
GPQS = ("gpq", "gpq-optimistic")
OPTIMUM, ROUNDING = 0.4378, 1e-4
"""Gridworld's value from the start by the best policy, as printed."""
BALANCED = 2900.0
"""Mean steps of an episode, of 3,000."""
BALANCING_SEEDS = 0.9
SLACK = 1.1
"""Of the puddle world's cost: within 10% of the best fixed bases."""
LARGEST_RETURN = 41.0 / (1.0 - 0.99)
"""What a policy can lose at most in the puddle world; larger errors are divergence."""
RESAMPLES = 9_999


def optimal(record: Record) -> bool:
    """Whether the greedy policy is the best one of Gridworld, exactly."""
    return record.exact_value is not None and record.exact_value >= OPTIMUM - ROUNDING


def balanced(record: Record) -> bool:
    """Whether the greedy policy keeps the pendulum up."""
    return record.length_mean >= BALANCED


def diverged(record: Record) -> bool:
    """Whether a learner has stopped, or its errors are larger than any return."""
    metrics = record.metrics
    return bool(metrics.get("diverged")) or not abs(metrics.get("td_error", 0.0)) <= LARGEST_RETURN


def first_steps(runs: Sequence[Sequence[Record]], reached: Callable[[Record], bool]) -> FloatArray:
    """Return the steps (seeds,) at which each run first reached a goal; infinite: never."""
    return np.array([min((r.steps for r in run if reached(r)), default=np.inf) for run in runs])


def joined(whole: Curves, early: Curves) -> Curves:
    """Return the runs with more evaluations of their first steps: a seed fixes what is learned."""
    return {
        name: [(*first, *run) for first, run in zip(early[name], runs, strict=True)]
        if name in early
        else runs
        for name, runs in whole.items()
    }


def median_interval(values: FloatArray) -> tuple[float, float, float]:
    """Return the median (the upper of two middle values) with its percentile bootstrap interval."""
    rng = np.random.default_rng(0)
    middle = len(values) // 2
    resampled = np.sort(values[rng.integers(len(values), size=(RESAMPLES, len(values)))], axis=1)
    low, high = np.quantile(resampled[:, middle], (0.025, 0.975), method="nearest")
    return float(np.sort(values)[middle]), float(low), float(high)


def judge(claim: str, found: str, holds: bool) -> bool:
    """Print a claim and what was found; return whether it holds."""
    print(f"{'pass' if holds else 'FAIL'}  {claim}: {found}", flush=True)
    return holds


def show_steps(runs: Curves, reached: Callable[[Record], bool]) -> dict[str, FloatArray]:
    """Print when each contender reached a goal, and how many seeds hold it at the end."""
    steps = {name: first_steps(found, reached) for name, found in runs.items()}
    header = f"{'median steps':>14}{'95% interval':>22}{'reached':>10}{'held':>8}"
    print(f"{'':6}{'contender':18}{header}")
    for name, values in steps.items():
        median, low, high = median_interval(values)
        held = sum(reached(run[-1]) for run in runs[name])
        interval = f"{low:,.0f} to {high:,.0f}"
        print(
            f"{'':6}{name:18}{median:14,.0f}{interval:>22}"
            f"{np.isfinite(values).sum():>7}/{len(values)}{held:>5}/{len(values)}"
        )
    return steps


def judge_gridworld(runs: Curves) -> bool:
    """Both variants find the best policy on every seed, the optimist in fewer steps."""
    print("== Gridworld: greedy policy optimal")
    steps = show_steps(runs, optimal)
    passed = True
    for name in GPQS:
        reached = int(np.isfinite(steps[name]).sum())
        claim = f"{name} reaches {OPTIMUM} on every seed"
        passed &= judge(claim, f"{reached} of {len(steps[name])}", reached == len(steps[name]))
    epsilon, optimistic = (median_interval(steps[name])[0] for name in GPQS)
    found = f"medians {optimistic:,.0f} and {epsilon:,.0f}"
    return judge("the optimist needs fewer steps", found, optimistic < epsilon) and passed


def judge_pendulum(runs: Curves) -> bool:
    """GPQ balances on 18 of 20 seeds, and in fewer steps than all others."""
    print(f"== Inverted pendulum: at least {BALANCED:,.0f} steps, mean of the greedy episodes")
    steps = show_steps(runs, balanced)
    medians = {name: median_interval(values)[0] for name, values in steps.items()}
    passed = True
    for name in GPQS:
        share = np.mean([balanced(run[-1]) for run in runs[name]])
        claim = f"{name} balances at the end on at least {BALANCING_SEEDS:.0%} of the seeds"
        passed &= judge(claim, f"{share:.0%}", bool(share >= BALANCING_SEEDS))
        for other in sorted(set(medians) - set(GPQS)):
            found = f"medians {medians[name]:,.0f} and {medians[other]:,.0f}"
            claim = f"{name} needs fewer steps than {other}"
            passed &= judge(claim, found, medians[name] < medians[other])
    return passed


def judge_puddles(runs: Curves) -> bool:
    """GPQ costs no more than the best fixed bases and a tenth, and only its rivals diverge."""
    print("== Puddle world: mean discounted return of the last greedy evaluation")
    returns = {name: np.mean([run[-1].return_mean for run in own]) for name, own in runs.items()}
    explode = {name: [any(map(diverged, run)) for run in own] for name, own in runs.items()}
    for name, value in returns.items():
        print(f"{'':6}{name:18}{value:10.2f}   diverged: {sum(explode[name])}/{len(explode[name])}")
    fixed = [n for n in runs if n.startswith(("linear-q", "gq")) and not any(explode[n])]
    best = max(fixed, key=lambda name: returns[name])
    passed = True
    for name in GPQS:
        found = f"{returns[name]:.2f}, {best} {returns[best]:.2f}"
        claim = f"{name} is within 10% of the best fixed bases"
        passed &= judge(claim, found, bool(returns[name] >= SLACK * returns[best]))
        found = f"{sum(explode[name])} of {len(explode[name])} runs"
        passed &= judge(f"{name} never diverges", found, not any(explode[name]))
    for name in ("linear-q-worst", "gq-worst"):
        found = f"{sum(explode[name])} of {len(explode[name])} runs"
        passed &= judge(f"{name} diverges", found, all(explode[name]))
    return passed


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the records; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=KEPT, help="of figure 3.2")
    parser.add_argument("--quick", action="store_true", help="the records are of the quick size")
    options = parser.parse_args(arguments)
    runs: dict[str, Curves] = {}
    for panel in find("figure-3.2").panels:
        if isinstance(panel, Comparison):
            for name, experiment in panel.sized(options.quick).items():
                found = finished_runs(read_runs(experiment, options.folder / name))
                if missing := [who for who, finished in found.items() if not finished]:
                    parser.error(f"{options.folder / name}: no finished run of {missing[0]}")
                runs[name] = found
    passed = judge_gridworld(runs["gridworld"])
    pendulum = joined(runs["pendulum"], runs["pendulum-early"])
    passed &= judge_pendulum(pendulum | runs["pendulum-deep"])
    passed &= judge_puddles(runs["puddles"] | runs["puddles-deep"])
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
