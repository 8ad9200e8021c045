"""Means with intervals, by the bootstrap or, of few values, Student's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bnprl_envs.tables import FloatArray

CONFIDENCE = 0.95
FEW = 8
"""Fewer values than this get Student's interval: a bootstrap cannot leave their range, and that of
five holds the mean in nine cases of ten at best."""
RESAMPLES = 9_999
STRATIFIED_RESAMPLES = 2_000
DRAWS = 10_000_000
"""Largest number of draws of one interval; large samples get fewer resamples."""


@dataclass(frozen=True)
class Interval:
    """A mean and its confidence interval, which one value alone does not have."""

    mean: float
    low: float | None
    high: float | None


def mean_interval(values: npt.ArrayLike, confidence: float = CONFIDENCE, seed: int = 0) -> Interval:
    """Return the mean of (n,) values with its interval: bootstrap's, or Student's below `FEW`.

    Equal seeds give equal intervals.

    Args:
        values: independent, finite.
        confidence: in (0, 1).
        seed: of the resampling.

    Raises:
        ValueError: there is no value, or one is not finite.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        raise ValueError(f"values: shape {sample.shape}, must be (n,) with n at least 1")
    if not np.isfinite(sample).all():
        raise ValueError("values: must be finite")
    mean = float(sample.mean())
    if sample.size == 1:
        return Interval(mean, None, None)
    low, high = _interval(sample[:, None], confidence, seed)
    return Interval(mean, float(low[0]), float(high[0]))


def bootstrap_interval(
    strata: Sequence[FloatArray],
    statistic: Callable[[list[FloatArray]], FloatArray],
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> Interval:
    """Return a statistic of several samples with its percentile interval.

    Each sample is resampled by itself (a stratified bootstrap), so that every resample has as many
    values of each.

    Args:
        strata: samples, each (n,) with n at least 1; one value each: there is no interval.
        statistic: samples (..., n) -> (...,).
        confidence: in (0, 1).
        seed: of the resampling.
    """
    value = float(statistic(list(strata)))
    if all(len(sample) == 1 for sample in strata):
        return Interval(value, None, None)
    rng = np.random.default_rng(seed)
    drawn = [rng.choice(sample, (STRATIFIED_RESAMPLES, len(sample))) for sample in strata]
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(statistic(drawn), (tail, 1.0 - tail))
    return Interval(value, min(float(low), value), max(float(high), value))


def mean_band(
    curves: FloatArray, confidence: float = CONFIDENCE, seed: int = 0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean of (n, points) curves and the ends of its interval at each point.

    The intervals are those of `mean_interval`. One curve alone is its own band.
    """
    mean = curves.mean(axis=0)
    if len(curves) == 1:
        return mean, mean, mean
    return mean, *_interval(curves, confidence, seed)


def expanded(size: int, confidence: float) -> float:
    """Return the level at which the percentile interval of n values is as wide as Student's.

    Percentiles of the resampled means are too close by sqrt((n - 1) / n), and by the normal's
    tails in place of Student's: of ten values they hold the mean in 90% of all cases, not in 95%.

    Paper: Hesterberg (2015), *What teachers should know about the bootstrap*.
    """
    from scipy.stats import norm

    z = _student(size, confidence) * (size / (size - 1)) ** 0.5
    return float(norm.cdf(z) - norm.cdf(-z))


def _interval(sample: FloatArray, confidence: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return both ends (points,) of the interval of the mean of (n, points), n at least 2."""
    size = len(sample)
    if size < FEW:
        mean = sample.mean(axis=0)
        half = _student(size, confidence) * sample.std(axis=0, ddof=1) / size**0.5
        return mean - half, mean + half
    return _bootstrap(sample, expanded(size, confidence), seed)


def _student(size: int, confidence: float) -> float:
    from scipy.stats import t  # takes a second to import

    return float(t.ppf((1.0 + confidence) / 2.0, size - 1))


def _bootstrap(sample: FloatArray, confidence: float, seed: int) -> tuple[FloatArray, FloatArray]:
    from scipy.stats import bootstrap  # takes a second to import

    resamples = int(np.clip(DRAWS // sample.size, 999, RESAMPLES))
    result: Any = bootstrap(
        (sample,),
        np.mean,
        axis=0,
        n_resamples=resamples,
        batch=max(1, 1_000_000 // sample.size),
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    ends = result.confidence_interval
    mean = sample.mean(axis=0)  # rounding must not put it outside
    return np.minimum(ends.low, mean), np.maximum(ends.high, mean)
