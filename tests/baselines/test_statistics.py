from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, sem, t

from baselines.statistics import Interval, expanded, mean_band, mean_interval


@pytest.mark.parametrize("size", [2, 3, 5, 7, 8, 10, 30])
def test_intervals_of_few_values_hold_the_mean_as_often_as_they_say(size: int) -> None:
    samples = np.random.default_rng(size).normal(size=(400, size))
    found = [mean_interval(sample) for sample in samples]
    held = [i.low <= 0.0 <= i.high for i in found if i.low is not None and i.high is not None]
    assert len(held) == 400
    assert 0.91 < np.mean(held) < 0.98


def test_the_interval_of_three_values_is_students() -> None:
    interval = mean_interval([1.0, 2.0, 4.0])
    low, high = t.interval(0.95, 2, loc=7 / 3, scale=sem([1.0, 2.0, 4.0]))
    assert interval.mean == pytest.approx(7 / 3)
    assert (interval.low, interval.high) == pytest.approx((low, high))


def test_the_bootstraps_level_makes_up_for_the_number_of_values() -> None:
    assert expanded(5, 0.95) == pytest.approx(0.9981, abs=1e-4)
    assert expanded(10**6, 0.95) == pytest.approx(0.95, abs=1e-5)


def test_interval_of_a_proportion_is_binomial() -> None:
    interval = mean_interval([0.0] * 50 + [1.0] * 50)
    low, high = binom.ppf(0.025, 100, 0.5) / 100, binom.ppf(0.975, 100, 0.5) / 100
    assert interval.mean == 0.5
    assert interval.low == pytest.approx(low, abs=0.011)
    assert interval.high == pytest.approx(high, abs=0.011)
    narrow = mean_interval([0.0] * 50 + [1.0] * 50, confidence=0.5)
    assert narrow.low is not None
    assert interval.low is not None
    assert narrow.low > interval.low + 0.03


def test_one_value_has_no_interval() -> None:
    assert mean_interval([3.0]) == Interval(3.0, None, None)


@pytest.mark.parametrize("value", [0.1, -1e-20, 0.0, 1e9 + 0.1])
def test_equal_values_have_a_degenerate_interval(value: float) -> None:
    interval = mean_interval([value] * 3)
    assert interval.mean == pytest.approx(value)
    assert interval.low == pytest.approx(value)
    assert interval.high == pytest.approx(value)
    assert interval.low is not None
    assert interval.high is not None
    assert interval.low <= interval.mean <= interval.high


def test_the_seed_decides() -> None:
    values = np.random.default_rng(0).normal(size=20)
    assert mean_interval(values, seed=1) == mean_interval(values, seed=1)
    assert mean_interval(values, seed=1) != mean_interval(values, seed=2)


def test_large_samples_stay_cheap_and_right() -> None:
    values = np.random.default_rng(0).normal(size=50_000)
    interval = mean_interval(values)
    assert interval.low == pytest.approx(interval.mean - 1.96 / np.sqrt(50_000), rel=0.2)


@pytest.mark.parametrize("values", [[], [[1.0, 2.0]], [1.0, float("nan")], [float("inf")]])
def test_what_is_no_sample_is_refused(values: list[float]) -> None:
    with pytest.raises(ValueError, match="values"):
        mean_interval(values)


def test_a_band_is_an_interval_at_each_point() -> None:
    curves = np.array([[1.0, 5.0], [2.0, 5.0], [4.0, 5.0]])
    mean, low, high = mean_band(curves)
    interval = mean_interval(curves[:, 0])
    np.testing.assert_allclose(mean, [7 / 3, 5.0])
    np.testing.assert_allclose(low, [interval.low, 5.0])
    np.testing.assert_allclose(high, [interval.high, 5.0])
    for part in mean_band(curves[:1]):
        np.testing.assert_array_equal(part, curves[0])
