"""How much better than expected actions were, by a critic that is fitted on the way."""

from __future__ import annotations

import numpy as np
from numba import njit

from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.proximal.config import ProximalConfig
from bnprl_agents.proximal.critic import Critic, Histories

SWEEPS = 2
"""Fits of the critic to its own bootstrapped returns, a batch."""
SCALE_MEMORY = 0.9
"""Share of the running scale of the advantages that a batch leaves."""


def advantages(
    episodes: EpisodeBatch,
    values: tuple[FloatArray, FloatArray],
    discount: float,
    decay: float,
    ratio: FloatArray,
) -> FloatArray:
    """Generalised advantage estimates (Schulman et al., ICLR 2016), corrected off-policy.

    A_t = delta_t + discount decay min(1, ratio_{t+1}) A_{t+1},
    delta_t = r_t + discount V_{t+1} - V_t; nothing follows a terminal state, and a truncated
    episode goes on at the value of its last history.

    Args:
        episodes: K episodes.
        values: V before each action (S,), and at each end (K,).
        discount: factor in (0, 1].
        decay: lambda; 0 trusts the critic, 1 the returns.
        ratio: (S,) probability of each action under the policy, over that of the behaviour.
    """
    before, final = values
    after = np.where(episodes.terminated, 0.0, final)
    trace = discount * decay * np.minimum(ratio, 1.0)
    found: FloatArray = _advantages(
        episodes.offsets, episodes.rewards, before, after, discount, trace
    )
    return found


def judged(
    critic: Critic,
    episodes: EpisodeBatch,
    histories: Histories,
    ratio: FloatArray,
    config: ProximalConfig,
    *,
    discount: float,
    ridge: float,
) -> tuple[Critic, FloatArray]:
    """Fit a critic to its own bootstrapped returns; return it and the advantages (S,) by it.

    Args:
        critic: of the batches before.
        episodes: K episodes of S steps.
        histories: theirs.
        ratio: (S,) probability of each action under the policy, over that of the behaviour.
        config: the two lambdas and the critic's memory.
        discount: factor in (0, 1].
        ridge: see `Critic.fitted`.
    """
    fitted = critic
    for _ in range(SWEEPS):
        values = fitted.values(histories)
        returns = values[0] + advantages(episodes, values, discount, config.return_decay, ratio)
        fitted = critic.fitted(histories, returns, config.critic_memory, ridge)
    values = fitted.values(histories)
    return fitted, advantages(episodes, values, discount, config.advantage_decay, ratio)


def standardised(
    advantage: FloatArray, weight: FloatArray, scale: float
) -> tuple[FloatArray, float]:
    """Centre advantages (S,) and divide them by their running scale.

    Args:
        advantage: of S steps.
        weight: (S,) of each.
        scale: running standard deviation of the batches before; 0 if there was none.

    Returns:
        The standardised advantages, and the scale that divided them.
    """
    centred = advantage - np.average(advantage, weights=weight)
    spread = float(np.sqrt(np.average(centred**2, weights=weight)))
    new = SCALE_MEMORY * scale + (1.0 - SCALE_MEMORY) * spread if scale > 0.0 else spread
    return centred / max(new, np.finfo(np.float64).tiny), new


@njit(cache=True)
def _advantages(offsets, rewards, values, after, discount, trace):  # type: ignore[no-untyped-def]
    advantage = np.empty(rewards.size)
    for k in range(offsets.size - 1):
        last = offsets[k + 1] - 1
        advantage[last] = rewards[last] + discount * after[k] - values[last]
        for t in range(last - 1, offsets[k] - 1, -1):
            surprise = rewards[t] + discount * values[t + 1] - values[t]
            advantage[t] = surprise + trace[t + 1] * advantage[t + 1]
    return advantage
