"""Which of two contenders is better, and which of many over several environments.

The quantities are those of Agarwal et al. (2021), *Deep reinforcement learning at the edge of the
statistical precipice*: interquartile means, probabilities of improvement, performance profiles.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from baselines.statistics import Interval, bootstrap_interval
from bnprl_envs.tables import FloatArray

PERMUTATIONS = 9_999
"""Random permutations of a test."""


@dataclass(frozen=True)
class Pair:
    """Two contenders by the final values of their runs.

    Attributes:
        first: name of the one.
        second: name of the other.
        difference: mean of the first less mean of the second.
        improvement: probability that a run of the first is better than one of the second, ties
            counted half.
        p_value: of a two-sided permutation test of equal means, Holm's correction for the number
            of pairs included; None with fewer than two runs of either.
    """

    first: str
    second: str
    difference: float
    improvement: float
    p_value: float | None


def pairs(scores: Mapping[str, Sequence[FloatArray]], seed: int = 0) -> list[Pair]:
    """Compare every two contenders, the better one first.

    Args:
        scores: contender -> environment -> (n,) final value of each run; environments count alike.
        seed: of the permutations.
    """
    order = sorted(scores, key=lambda name: -_mean(scores[name]))
    couples = list(itertools.combinations(order, 2))
    raw = [permutation_test(scores[a], scores[b], seed) for a, b in couples]
    corrected = iter(holm([p for p in raw if p is not None]))
    return [
        Pair(
            a,
            b,
            _mean(scores[a]) - _mean(scores[b]),
            float(np.mean([*map(probability_of_improvement, scores[a], scores[b])])),
            None if p is None else next(corrected),
        )
        for (a, b), p in zip(couples, raw, strict=True)
    ]


def _mean(strata: Sequence[FloatArray]) -> float:
    return float(np.mean([values.mean() for values in strata]))


def probability_of_improvement(x: FloatArray, y: FloatArray) -> float:
    """Return P(X > Y) + P(X = Y) / 2 of two samples (n,) and (m,)."""
    difference = np.subtract.outer(x, y)
    return float(((difference > 0) + 0.5 * (difference == 0)).mean())


def permutation_test(
    x: Sequence[FloatArray], y: Sequence[FloatArray], seed: int = 0
) -> float | None:
    """Return the two-sided p-value of equal means, labels permuted within each environment.

    Args:
        x: environment -> (n,) values of the one.
        y: environment -> (m,) values of the other.
        seed: of the permutations.

    Returns:
        None where an environment has fewer than two values of either.
    """
    if min(len(values) for values in (*x, *y)) < 2:
        return None
    rng = np.random.default_rng(seed)
    difference = np.zeros(PERMUTATIONS)
    for one, other in zip(x, y, strict=True):
        drawn = rng.permuted(np.tile(np.concatenate([one, other]), (PERMUTATIONS, 1)), axis=1)
        difference += drawn[:, : len(one)].mean(axis=1) - drawn[:, len(one) :].mean(axis=1)
    observed = len(x) * abs(_mean(x) - _mean(y))
    extreme = np.abs(difference) >= observed * (1.0 - 1e-9)  # rounding must not lose ties
    return float((1 + extreme.sum()) / (1 + PERMUTATIONS))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979), in the order given."""
    order = np.argsort(p_values)
    steps = np.arange(len(order), 0, -1)
    corrected = np.maximum.accumulate(np.asarray(p_values, float)[order] * steps)
    found = np.empty(len(order))
    found[order] = np.minimum(corrected, 1.0)
    return [float(p) for p in found]


def interquartile_mean(scores: Sequence[FloatArray], seed: int = 0) -> Interval:
    """Return the mean of the middle half of all runs' scores, with its interval.

    Args:
        scores: environment -> (n,) normalised scores; resampled within each environment.
        seed: of the resampling.
    """
    from scipy.stats import trim_mean

    def middle(drawn: list[FloatArray]) -> FloatArray:
        return np.asarray(trim_mean(np.concatenate(drawn, axis=-1), 0.25, axis=-1))

    return bootstrap_interval(scores, middle, seed=seed)


def performance_profile(scores: Sequence[FloatArray], thresholds: FloatArray) -> FloatArray:
    """Return the share of runs above each threshold (points,), environments weighted equally."""
    shares = np.array([(values[:, None] > thresholds).mean(axis=0) for values in scores])
    return np.asarray(shares.mean(axis=0))
