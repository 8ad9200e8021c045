"""Stick-breaking rows with Gamma hyper-priors, section 6.4 and appendix 6.8.2, corrected.

A row over Z nodes is W_j = V_j prod_{m<j} (1 - V_m), V_Z = 1, with V_j ~ Beta(1, Sigma_j) and
Sigma_j ~ Gamma(c, rate d). The variational posterior is a product of q(V_j), a Beta, and
q(Sigma_j) = Gamma(c + 1, rate). All arrays of sticks are (..., Z - 1), all rows (..., Z).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import betaln, digamma, gammaln

from bnprl_agents.episodes import FloatArray


class Sticks(NamedTuple):
    """q(V) q(Sigma) of rows.

    Attributes:
        first: sigma hat, the first parameter of each stick's Beta distribution.
        second: Sigma hat, the second one.
        rate: of the Gamma distribution of Sigma, whose shape is c + 1.
    """

    first: FloatArray
    second: FloatArray
    rate: FloatArray


def tails(rows: FloatArray) -> FloatArray:
    """sum_{l > j} of rows, for every stick j."""
    return np.cumsum(rows[..., :0:-1], axis=-1)[..., ::-1]


LEAST_VISITS = 1e-100
"""Of a stick's two sides: a divergence from what has a side of 0 is infinite."""


def sticks_around(rows: FloatArray, visits: float, shape: float) -> Sticks:
    """Sticks whose mean is given rows, as from so many visits, with E Sigma = 1."""
    first = np.maximum(visits * rows[..., :-1], LEAST_VISITS)
    second = np.maximum(visits * tails(rows), LEAST_VISITS)
    return Sticks(first, second, np.full(first.shape, shape + 1.0))


def updated_sticks(
    counts: FloatArray, old: Sticks, shape: float, rate: float, iterations: int
) -> Sticks:
    """Coordinate ascent on q(V) and q(Sigma), given counts; (6.15), (6.31), (6.34).

    sigma hat_j = 1 + omega_j and Sigma hat_j = E[Sigma_j] + sum_{l>j} omega_l, then
    q(Sigma_j) = Gamma(c + 1, d - E ln(1 - V_j)).

    Args:
        counts: omega or v.
        old: where the ascent begins.
        shape: c > 0 of the hyper-prior.
        rate: d > 0 of the hyper-prior.
        iterations: of the two steps, at least 1; none lowers the bound.
    """
    first, after, gamma_rate = 1.0 + counts[..., :-1], tails(counts), old.rate
    for _ in range(iterations):
        second = (shape + 1.0) / gamma_rate + after
        gamma_rate = rate - (digamma(second) - digamma(first + second))
    return Sticks(first, second, gamma_rate)


def mean_rows(sticks: Sticks) -> FloatArray:
    """E[W_j] = E[V_j] prod_{m<j} E[1 - V_m]; what is left goes to the last node."""
    share = sticks.first / (sticks.first + sticks.second)
    return _broken(share, 1.0 - share)


def geometric_rows(sticks: Sticks) -> FloatArray:
    """exp(E ln W_j), E ln W_j = E ln V_j + sum_{m<j} E ln(1 - V_m); (6.14)."""
    total = digamma(sticks.first + sticks.second)
    return _broken(np.exp(digamma(sticks.first) - total), np.exp(digamma(sticks.second) - total))


def stick_divergence(sticks: Sticks, shape: float, rate: float) -> float:
    """E_q(Sigma) KL(q(V) || Beta(1, Sigma)) + KL(q(Sigma) || Gamma(c, d)), summed over sticks."""
    total = digamma(sticks.first + sticks.second)
    log_v, log_rest = digamma(sticks.first) - total, digamma(sticks.second) - total
    mean, log_mean = (shape + 1.0) / sticks.rate, digamma(shape + 1.0) - np.log(sticks.rate)
    of_sticks = (
        (sticks.first - 1.0) * log_v
        + (sticks.second - mean) * log_rest
        - betaln(sticks.first, sticks.second)
        - log_mean
    )
    of_hyper = (
        digamma(shape + 1.0)
        - gammaln(shape + 1.0)
        + gammaln(shape)
        + shape * (np.log(sticks.rate) - np.log(rate))
        + (shape + 1.0) * (rate / sticks.rate - 1.0)
    )
    return float(np.sum(of_sticks + of_hyper))


def _broken(share: FloatArray, rest: FloatArray) -> FloatArray:
    """share_j prod_{m<j} rest_m, and at last prod_m rest_m."""
    one = np.ones((*share.shape[:-1], 1))
    left = np.cumprod(np.concatenate([one, rest], axis=-1), axis=-1)
    return np.concatenate([share, one], axis=-1) * left
