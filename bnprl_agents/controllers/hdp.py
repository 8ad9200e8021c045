"""Gibbs steps of a hierarchical Dirichlet process over nodes, section 5.2.

beta ~ GEM(lambda) weighs the nodes; every row over nodes is DP(alpha, beta). Given counts of rows,
the auxiliary table counts m make beta conjugate.

Paper: Teh, Jordan, Beal and Blei, Hierarchical Dirichlet processes, JASA 101, 2006, section 5.3 and
appendix A.
"""

from __future__ import annotations

import numpy as np
from scipy.special import digamma

from bnprl_agents.episodes import FloatArray, IntArray

DRAWN = 256
"""Customers of a row whose tables are drawn one by one."""

GammaPrior = tuple[float, float]
"""Shape and rate."""


def sample_tables(counts: FloatArray, weights: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw the table counts m of rows, p(m) proportional to S(ceil(phi), m) (alpha beta)^m.

    Customer i = 1, 2, ... of ceil(phi) opens a table with probability w / (w + i - 1); the
    openings of those after the first `DRAWN` are rare and drawn as one Poisson variable.

    Args:
        counts: (..., n) phi >= 0.
        weights: (n,) w = alpha beta; positive where a count is.
        rng: source of the draws.
    """
    tables = np.zeros(counts.shape, dtype=np.int64)
    place = np.nonzero(counts)
    customers, weight = np.ceil(counts[place]).astype(np.int64), weights[place[-1]]
    drawn = np.minimum(customers, DRAWN)
    owner = np.repeat(np.arange(drawn.size), drawn)
    rank = np.arange(owner.size) - np.repeat(np.cumsum(drawn) - drawn, drawn)
    opens = rng.random(owner.size) * (weight[owner] + rank) < weight[owner]
    found = np.bincount(owner[opens], minlength=drawn.size)
    later = weight * (digamma(weight + customers) - digamma(weight + drawn))
    tables[place] = found + rng.poisson(np.maximum(later, 0.0))
    return tables


def sample_weights(tables: IntArray, top: float, rng: np.random.Generator) -> FloatArray:
    """Draw beta_{1:n+1} ~ Dir(m_1, ..., m_n, lambda), the last entry for all other nodes."""
    return rng.dirichlet(np.append(tables.astype(np.float64), top))


def sample_row_concentration(
    alpha: float, totals: FloatArray, tables: int, prior: GammaPrior, rng: np.random.Generator
) -> float:
    """Draw alpha given the rows' totals and all tables.

    With w_j ~ Beta(alpha + 1, n_j) and s_j ~ Bernoulli(n_j / (n_j + alpha)):
    alpha ~ Gamma(a + m - sum s_j, b - sum ln w_j).

    Args:
        alpha: the current value.
        totals: (rows,) n_j; rows with none are left out.
        tables: m, of all rows.
        prior: shape a and rate b.
        rng: source of the draws.
    """
    customers = totals[totals > 0.0]
    log_w = np.log(rng.beta(alpha + 1.0, customers))
    s = rng.random(customers.size) * (customers + alpha) < customers
    shape, rate = prior[0] + tables - int(s.sum()), prior[1] - float(log_w.sum())
    return float(rng.gamma(shape, 1.0 / rate))


def sample_top_concentration(
    top: float, nodes: int, tables: int, prior: GammaPrior, rng: np.random.Generator
) -> float:
    """Draw lambda given how many nodes all the tables hold: the case of one row, Escobar and West.

    Args:
        top: the current value.
        nodes: distinct nodes.
        tables: m, of all rows.
        prior: shape and rate.
        rng: source of the draws.
    """
    return sample_row_concentration(top, np.array([float(tables)]), nodes, prior, rng)
