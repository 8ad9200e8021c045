"""Learning rates that fall with the number of transitions."""

from __future__ import annotations

from typing import Any

from numba import njit

from bnprl_agents.gaussian_process.kernels import check_positive
from bnprl_agents.value_learner import check_exponent


@njit(cache=True)
def learning_rate(initial, exponent, steps):  # type: ignore[no-untyped-def]
    """Return c / t^a at the t-th transition, before which there were `steps`."""
    return initial * (1.0 + steps) ** -exponent


def check_schedules(settings: Any) -> None:
    """Check the schedules of a config.

    Raises:
        ValueError: the initial rate is not positive, or an exponent negative.
    """
    check_positive("initial_rate", settings.initial_rate)
    check_exponent("rate_exponent", settings.rate_exponent)
    check_exponent("exploration_exponent", settings.exploration_exponent)
