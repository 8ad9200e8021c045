"""Learning rates of running means, and the running value, which is kept as a logarithm."""

from __future__ import annotations

from typing import Any

import numpy as np

from bnprl_agents.policy_files import INFINITE, number


def check_schedule(exponent: float, offset: float) -> None:
    """Check the settings of a Robbins-Monro schedule.

    Raises:
        ValueError: names the setting, what it was and what is allowed.
    """
    if not 0.5 < exponent <= 1.0:
        raise ValueError(f"rate_exponent: {exponent}, must lie in (0.5, 1]")
    if not 0.0 < offset < np.inf:
        raise ValueError(f"rate_offset: {offset}, must be positive")


def robbins_monro(updates: int, exponent: float, offset: float) -> float:
    """Learning rate alpha_n = (1 + n / offset)^-exponent of update n."""
    return float((1.0 + updates / offset) ** -exponent)


def exponential(logarithm: float) -> float:
    """exp, infinite where it overflows: importance ratios know no bound."""
    with np.errstate(over="ignore"):
        return float(np.exp(logarithm))


def saved_log(logarithm: float) -> float | None:
    """A logarithm as JSON has it: that of 0 is null."""
    return None if logarithm == -np.inf else logarithm


def restored_log(value: Any) -> float:
    """Return what `saved_log` was given.

    Raises:
        ValueError: it is no number.
    """
    return -np.inf if value in (None, INFINITE["-Infinity"]) else number("log_value", value)


def blended_value(log_old: float, log_new: float, rate: float) -> tuple[float, float]:
    """Blend two values given by their logarithms.

    Returns:
        ln((1 - rate) V + rate V_n) and the new one's share of it. V_n must be positive.
    """
    log_fresh = np.log(rate) + log_new
    with np.errstate(divide="ignore"):
        log_total = float(np.logaddexp(np.log1p(-rate) + log_old, log_fresh))
    return log_total, float(np.exp(log_fresh - log_total))
