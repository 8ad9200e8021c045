"""How many nodes iRPR settles at, begun with too few and with too many.

`python -m baselines.benchmarks.node_inference` learns the noisy maze from one node and from twelve,
and prints exact values and nodes in use with 95% intervals over seeds. A policy without
memory earns .690 there, the best .731, which takes three nodes. It exits 1 where the mean value
stays below what memory begins to pay, the two beginnings end at clearly different values or
numbers of nodes, a run ends with one node, or a beginning does not grow or shrink.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any, NamedTuple

import numpy as np

from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.learners import build_learner
from baselines.statistics import Interval, mean_interval
from bnprl_agents.controllers.value import controller_value

MAZE = EnvironmentSpec("bnprl/NoisyMaze1D-v0")
EPISODES = 1000
BEGINNINGS = (1, 12)
MEMORYLESS = 0.690012


class Outcome(NamedTuple):
    """Of one beginning: exact values and nodes in use (seeds,)."""

    values: list[float]
    nodes: list[float]

    @property
    def intervals(self) -> tuple[Interval, Interval]:
        """Means of both with their intervals."""
        return mean_interval(self.values), mean_interval(self.nodes)


def learn(initial_nodes: int, seed: int, episodes: int) -> tuple[float, float]:
    """Exact value and nodes in use of one run."""
    entry = contender("infinite-rpr")
    settings = type(entry.settings)(initial_nodes=initial_nodes)
    learner = build_learner(entry, MAZE, settings, seed)
    *_, last = learner.learn(episodes=episodes)
    model = MAZE.model()
    assert model is not None
    policy: Any = learner.policy
    value = controller_value(model, policy.controllers, model.discount)
    return value, last.metrics["nodes"]


def overlap(first: Interval, second: Interval) -> bool:
    """Whether two intervals have a point in common; of single values, whether they are equal."""
    ends = [
        (i.mean if i.low is None else i.low, i.mean if i.high is None else i.high)
        for i in (first, second)
    ]
    return max(low for low, _ in ends) <= min(high for _, high in ends)


def failures(few: Outcome, many: Outcome) -> list[str]:
    """Return what is not as it should be."""
    (value_few, nodes_few), (value_many, nodes_many) = few.intervals, many.intervals
    wanted = {
        "memory pays, from few": value_few.mean > MEMORYLESS,
        "memory pays, from many": value_many.mean > MEMORYLESS,
        "the same value": overlap(value_few, value_many),
        "about as many nodes": overlap(nodes_few, nodes_many)
        or abs(nodes_few.mean - nodes_many.mean) <= 1.0,
        "grows from few": nodes_few.mean > BEGINNINGS[0],
        "shrinks from many": nodes_many.mean < BEGINNINGS[1],
        "no collapse": min(few.nodes + many.nodes) > 1,
    }
    return [name for name, good in wanted.items() if not good]


def main(arguments: list[str] | None = None) -> int:
    """Run all seeds and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    options = parser.parse_args(arguments)
    outcomes = []
    for beginning in BEGINNINGS:
        runs = []
        for seed in range(options.seeds):
            runs.append(learn(beginning, seed, options.episodes))
            print(
                f"from {beginning:2} nodes, seed {seed}: value {runs[-1][0]:.4f}, "
                f"{runs[-1][1]:.0f} nodes",
                flush=True,
            )
        values, nodes = np.array(runs).T.tolist()
        outcomes.append(Outcome(values, nodes))
    for beginning, outcome in zip(BEGINNINGS, outcomes, strict=True):
        value, nodes = outcome.intervals
        print(f"from {beginning:2} nodes: value {_text(value, '.4f')}, nodes {_text(nodes, '.1f')}")
    failed = failures(*outcomes)
    print(f"FAIL: {', '.join(failed)}" if failed else "pass")
    return 1 if failed else 0


def _text(interval: Interval, form: str) -> str:
    if interval.low is None or interval.high is None:
        return format(interval.mean, form)
    return f"{interval.mean:{form}} [{interval.low:{form}}, {interval.high:{form}}]"


if __name__ == "__main__":
    sys.exit(main())
