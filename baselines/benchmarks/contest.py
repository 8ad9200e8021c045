"""A contest of speed: our code and a peer in turn, many short rounds, the median ratio."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

ROUNDS = 7
"""Rounds of a contest; a machine's noise falls on both sides, and the median drops the worst."""


@dataclass(frozen=True)
class Contest:
    """Two ways to do the same kind of work.

    Attributes:
        name: what is compared, as a line of the table.
        ours: does some work and returns how many units it did.
        peer: the same for the peer.
        wanted: smallest passing ratio of units per second, ours to the peer's.
        unit: what is counted.
    """

    name: str
    ours: Callable[[], float]
    peer: Callable[[], float]
    wanted: float
    unit: str = "steps"


@dataclass(frozen=True)
class Outcome:
    """Medians over the rounds of a contest: units per second, and the ratio of the two."""

    ours: float
    peer: float
    ratio: float


def run_contests(contests: Sequence[Contest], seconds: float) -> bool:
    """Run every contest and print the table.

    Args:
        contests: in the order of the table.
        seconds: time for each side of each contest, over all its rounds.

    Returns:
        Whether every ratio is at least the wanted one.
    """
    width = max((len(contest.name) for contest in contests), default=0)
    print(f"{'contest':{width}}  {'ours/s':>12}  {'peer/s':>12}  {'ratio':>8}  {'wanted':>8}")
    passed = True
    for contest in contests:
        outcome = measure(contest, seconds)
        won = outcome.ratio >= contest.wanted
        passed &= won
        print(
            f"{contest.name:{width}}  {outcome.ours:12,.0f}  {outcome.peer:12,.0f}  "
            f"{outcome.ratio:8.1f}  {contest.wanted:8.1f}  {contest.unit:8}  "
            f"{'pass' if won else 'FAIL'}",
            flush=True,
        )
    return passed


def measure(contest: Contest, seconds: float) -> Outcome:
    """Let both sides work in turn, after one unmeasured call of each."""
    contest.ours()
    contest.peer()
    ours, peer = [], []
    for _ in range(ROUNDS):
        ours.append(_speed(contest.ours, seconds / ROUNDS))
        peer.append(_speed(contest.peer, seconds / ROUNDS))
    ratio = statistics.median(a / b for a, b in zip(ours, peer, strict=True))
    return Outcome(statistics.median(ours), statistics.median(peer), ratio)


def _speed(work: Callable[[], float], seconds: float) -> float:
    """Return units per second of repeated calls that take at least `seconds` together."""
    units = 0.0
    begin = time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < seconds or units == 0.0:
        units += work()
    return units / elapsed
