"""Means with intervals, by the bootstrap or, of few values, Student's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

CONFIDENCE = 0.95
FEW = 5
"""Fewer values than this get Student's interval: the percentile bootstrap of two holds the mean in
half of all cases, of three in three quarters."""
RESAMPLES = 9_999
STRATIFIED_RESAMPLES = 2_000
DRAWS = 10_000_000
"""Largest number of draws of one interval; large samples get fewer resamples."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """A mean and its confidence interval, which one value alone does not have."""

    mean: float
    low: float | None
    high: float | None


def mean_interval(values: npt.ArrayLike, confidence: float = CONFIDENCE, seed: int = 0) -> Interval:
    """Return the mean of (n,) values with its percentile bootstrap interval, or Student's of `FEW`.

    The percentile interval is defined for every sample; the corrected and accelerated one is not
    (equal values). Equal seeds give equal intervals.

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
    if sample.size < FEW:
        half = _student(sample.size, confidence) * float(sample.std(ddof=1)) / sample.size**0.5
        return Interval(mean, mean - half, mean + half)
    low, high = _bootstrap(sample[:, None], confidence, seed)
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
    """Return the mean of (n, points) curves and the ends of its pointwise bootstrap interval.

    One curve alone is its own band; that of two or three reaches from the least to the greatest.
    """
    mean = curves.mean(axis=0)
    if len(curves) == 1:
        return mean, mean, mean
    low, high = _bootstrap(curves, confidence, seed)
    return mean, low, high


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
