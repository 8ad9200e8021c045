"""Exact tools on a model."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, eye_array, kron

from bnprl_envs.model import TabularModel
from bnprl_envs.tables import FloatArray

TOLERANCE = 1e-10
"""Largest error of a value, but for the rounding of double precision."""


def random_value(model: TabularModel, discount: float | None = None) -> float:
    """Return the infinite-horizon discounted value of uniformly random actions at the start.

    Args:
        model: one agent or many (each joint action is equally likely).
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1.
    """
    uniform = csr_array(np.full((1, model.n_actions), 1.0 / model.n_actions))
    mean_rows = csr_array(kron(uniform, eye_array(model.n_states)) @ model.transition_rows)
    mean_reward = model.expected_reward.mean(axis=0, keepdims=True)
    values = optimal_value(mean_rows, mean_reward, _below_one(model, discount))
    return float(model.start @ values)


def mdp_value(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the optimal value of every state (S,) if the state were observed.

    Args:
        model: one agent or many (as one agent that chooses the joint action).
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1.
    """
    return optimal_value(model.transition_rows, model.expected_reward, _below_one(model, discount))


def optimal_value(rows: csr_array, reward: FloatArray, discount: float) -> FloatArray:
    """Solve v = max_a (r_a + discount P_a v) by value iteration.

    After a sweep v' = L v the solution lies between v' + c min(v' - v) and v' + c max(v' - v)
    with c = discount / (1 - discount) (Puterman 1994, Theorem 6.6.3), which bounds the error
    and gives the last correction. Needs memory for the rows alone.

    Args:
        rows: sparse (A * S, S) transition rows.
        reward: (A, S) expected rewards.
        discount: in [0, 1).

    Returns:
        (S,) values, each within `TOLERANCE` or a few roundings.
    """
    scale = discount / (1.0 - discount)
    value = np.zeros(rows.shape[1])
    while True:
        swept = (reward + discount * (rows @ value).reshape(reward.shape)).max(axis=0)
        change = swept - value
        low, high = scale * change.min(), scale * change.max()
        rounding = 8 * np.finfo(np.float64).eps * np.abs(swept).max() * scale
        value = swept
        if high - low <= 2 * TOLERANCE + rounding:
            return np.asarray(value + (low + high) / 2)


def _below_one(model: TabularModel, discount: float | None) -> float:
    chosen = model.discount if discount is None else discount
    if not 0.0 <= chosen < 1.0:
        raise ValueError(f"discount: {chosen}, an infinite horizon needs one in [0, 1)")
    return chosen
