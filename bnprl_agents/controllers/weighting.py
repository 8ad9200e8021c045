"""How much each step of a batch of episodes counts: what turns rewards into evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bnprl_agents.controllers.messages import reward_weights, running_sum
from bnprl_agents.episodes import EpisodeBatch, FloatArray


class Evidence(NamedTuple):
    """Weighted steps.

    Attributes:
        shares: (S,) nu_t / K, which sum to 1; all 0 where the episodes say nothing.
        log_value: logarithm of the value that was divided by; minus infinity where it is 0.
        fit: the data's part of the variational lower bound, at the best node posteriors.
    """

    shares: FloatArray
    log_value: float
    fit: float


def by_reward(
    episodes: EpisodeBatch, likelihoods: Sequence[FloatArray], discount: float
) -> Evidence:
    """Importance-weighted rewards, nu_t = gamma^t r_t ratio_t / V; (4.1), (6.5).

    The fit is ln V: given the parameters, the best nu and node posteriors make (6.2) that.

    Args:
        episodes: K episodes.
        likelihoods: for each agent c_t, (S,).
        discount: factor in (0, 1].

    Raises:
        ValueError: a reward is negative.
    """
    weights, log_scale = reward_weights(episodes, likelihoods, discount)
    total = weights.sum()
    if total == 0.0:
        return Evidence(weights, -np.inf, -np.inf)
    log_value = float(log_scale + np.log(total / episodes.n_episodes))
    return Evidence(weights / total, log_value, log_value)


def by_return(
    episodes: EpisodeBatch,
    likelihoods: Sequence[FloatArray],
    discount: float,
    temperature: float,
    *,
    linear: bool = False,
) -> Evidence:
    """Whole episodes in proportion to a function of their standardised return z, on-policy.

    exp(temperature z) seeks what is best, luck included: a gamble that mostly loses pays where its
    gains are large. max(0, 1 + temperature z) is proportional to the return above the mean less
    so many standard deviations, and so minds losses down to there as much as gains.

    Rewards of any sign serve and a constant added to them changes nothing, so that no shift
    drowns the signal. An episode's weight is spread over its steps as gamma^t, so that what it
    did early counts as much as it mattered to the return. The weights do not depend on the
    parameters: this is a weighted likelihood of the episodes as they were acted, exploration
    included, not the empirical value (2.45).

    Args:
        episodes: K episodes.
        likelihoods: for each agent c_t, (S,).
        discount: of the returns, in (0, 1].
        temperature: larger values look at the best episodes only.
        linear: the second function.
    """
    returns = episodes.returns(discount)
    spread = returns.std()
    if spread <= 1e-12 * np.abs(returns).max():
        return Evidence(np.zeros(episodes.n_steps), -np.inf, -np.inf)
    if linear:
        weights = np.maximum(0.0, 1.0 + temperature * (returns - returns.mean()) / spread)
    else:
        weights = np.exp(temperature * (returns - returns.max()) / spread)
    weights /= weights.sum()
    fading = discount ** episodes.steps_into_episode()
    fading /= np.repeat(np.add.reduceat(fading, episodes.offsets[:-1]), episodes.lengths)
    shares = np.repeat(weights, episodes.lengths) * fading
    with np.errstate(divide="ignore"):
        log_steps = sum(np.log(c) for c in likelihoods)
    log_so_far = running_sum(episodes.offsets, log_steps)
    return Evidence(shares, 0.0, float(np.sum(shares * log_so_far, where=shares > 0.0)))
