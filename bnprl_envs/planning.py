"""Exact tools on a model: belief update, values, and bounds of the optimum by linear algebra.

Values are expected discounted returns over an infinite horizon unless a horizon is given. A
model of many agents counts as one agent that chooses the joint action and sees the joint
observation; its bounds hold for the decentralised problem too, whose optimum is not above.
Lower bounds by points are in `bnprl_envs.point_based`, memoryless policies in
`bnprl_envs.memoryless`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, diags_array, hstack

from bnprl_envs.model import TabularModel
from bnprl_envs.tables import FloatArray

TOLERANCE = 1e-10
"""Largest error of a value, but for the rounding of double precision."""


def belief_update(
    model: TabularModel, belief: npt.ArrayLike, action: int, observation: int
) -> tuple[FloatArray, float]:
    """Return the belief after an action and what was seen then, and how likely that was.

    b'(s') = O(a, s', o) sum_s b(s) T(a, s, s') / p, where p = p(o | b, a) (Kaelbling, Littman
    and Cassandra 1998, section 3.3). That an episode goes on is no evidence here: terminal
    states keep their share, which is worth 0 under every policy.

    Args:
        model: one agent or many.
        belief: (S,) distribution of the state.
        action: joint action in [0, A).
        observation: joint observation in [0, O).

    Returns:
        b' (S,) and p.

    Raises:
        ValueError: an argument is out of range, or the observation is impossible.
    """
    before = np.asarray(belief, dtype=np.float64)
    if before.shape != (model.n_states,):
        raise ValueError(f"belief: shape {before.shape}, must be ({model.n_states},)")
    if not (before >= 0).all():
        raise ValueError(f"belief: holds {before.min():.9g}, must be a distribution")
    if abs(before.sum() - 1) > 1e-6:
        raise ValueError(f"belief: sums to {before.sum():.9g}, must be a distribution")
    if not 0 <= action < model.n_actions:
        raise ValueError(f"action: {action}, must lie in [0, {model.n_actions})")
    if not 0 <= observation < model.n_observations:
        raise ValueError(f"observation: {observation}, must lie in [0, {model.n_observations})")
    seen = _rows_of(model.observation_rows, model, action)[:, [observation]].toarray().ravel()
    joint = seen * (before @ _rows_of(model.transition_rows, model, action))
    probability = float(joint.sum())
    if probability == 0.0:
        raise ValueError(
            f"observation: {observation} is impossible after action {action} from this belief"
        )
    return joint / probability, probability


def random_value(model: TabularModel, discount: float | None = None) -> float:
    """Return the infinite-horizon discounted value of uniformly random actions at the start.

    Args:
        model: one agent or many (each joint action is equally likely).
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1.
    """
    return policy_value(model, _uniform_policy(model), discount)


def policy_value(
    model: TabularModel, policy: npt.ArrayLike, discount: float | None = None
) -> float:
    """Return the infinite-horizon discounted value at the start of a policy over states.

    Args:
        model: one agent or many (the policy is over joint actions).
        policy: (S, A) probabilities.
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1, or the policy is no (S, A) array whose rows sum
            to 1.
    """
    table = np.asarray(policy, dtype=np.float64)
    wanted = (model.n_states, model.n_actions)
    if table.shape != wanted or (table < 0.0).any() or np.abs(table.sum(1) - 1.0).max() > 1e-9:
        raise ValueError(f"policy: shape {table.shape}, must be {wanted} and rows sum to 1")
    chosen = infinite_horizon_discount(model, discount)
    return float(model.start @ optimal_value(*_policy_tables(model, table), chosen))


def blind_vectors(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the value of taking one action for ever, from every state.

    v_a = r_a + discount P_a v_a: lower bounds of the optimum (Hauskrecht 2000, section 4.5).

    Args:
        model: one agent or many.
        discount: instead of the model's.

    Returns:
        (A, S).

    Raises:
        ValueError: the discount is not below 1.
    """
    chosen = infinite_horizon_discount(model, discount)
    return np.stack(
        [
            optimal_value(_rows_of(model.transition_rows, model, action), reward[None], chosen)
            for action, reward in enumerate(model.expected_reward)
        ]
    )


def blind_values(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the value at the start of taking each action for ever (A,).

    Args:
        model: one agent or many (joint actions).
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1.
    """
    return np.asarray(blind_vectors(model, discount) @ model.start)


def mdp_value(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the optimal value of every state (S,) if the state were observed.

    An upper bound; of many agents, the "MMDP" bound.

    Args:
        model: one agent or many (as one agent that chooses the joint action).
        discount: instead of the model's.

    Raises:
        ValueError: the discount is not below 1.
    """
    chosen = infinite_horizon_discount(model, discount)
    return optimal_value(model.transition_rows, model.expected_reward, chosen)


def q_mdp(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the value of every action if the state were observed from the next step on.

    The QMDP upper bound of a belief b is max_a b . Q_a (Littman, Cassandra and Kaelbling 1995).

    Args:
        model: one agent or many.
        discount: instead of the model's.

    Returns:
        (A, S).

    Raises:
        ValueError: the discount is not below 1.
    """
    chosen = infinite_horizon_discount(model, discount)
    return _action_values(
        model.transition_rows, model.expected_reward, chosen, mdp_value(model, chosen)
    )


def fib(model: TabularModel, discount: float | None = None) -> FloatArray:
    """Return the vectors of the fast informed bound.

    f(a, s) = r(a, s) + discount sum_o max_a' sum_s' T(a, s, s') O(a, s', o) f(a', s'); the upper
    bound of a belief b is max_a b . f_a, not above QMDP's (Hauskrecht 2000, section 4.2).

    Args:
        model: one agent or many.
        discount: instead of the model's.

    Returns:
        (A, S).

    Raises:
        ValueError: the discount is not below 1.
    """
    from bnprl_envs.backups import fib_backup, model_rows  # numba: imported where it is needed

    chosen = infinite_horizon_discount(model, discount)
    rows = model_rows(model)
    return fixed_point(
        lambda vectors: fib_backup(rows, chosen, vectors), model.expected_reward, chosen
    )


def finite_horizon_value(
    model: TabularModel, horizon: int, *, uniform: bool = False, discount: float = 1.0
) -> FloatArray:
    """Return the value of every state (S,) with `horizon` steps to go.

    Args:
        model: one agent or many.
        horizon: steps, at least 0.
        uniform: of uniformly random actions, instead of the optimum if the state were observed.
        discount: factor in [0, 1]; the model's is not used.

    Raises:
        ValueError: the horizon or the discount is out of range.
    """
    if horizon < 0:
        raise ValueError(f"horizon: {horizon}, must be at least 0")
    if not 0.0 <= discount <= 1.0:
        raise ValueError(f"discount: {discount}, must lie in [0, 1]")
    rows, reward = (
        _policy_tables(model, _uniform_policy(model))
        if uniform
        else (model.transition_rows, model.expected_reward)
    )
    value = np.zeros(model.n_states)
    for _ in range(horizon):
        value = _action_values(rows, reward, discount, value).max(axis=0)
    return value


def optimal_value(rows: csr_array, reward: FloatArray, discount: float) -> FloatArray:
    """Solve v = max_a (r_a + discount P_a v) by value iteration.

    Args:
        rows: sparse (A * S, S) transition rows.
        reward: (A, S) expected rewards.
        discount: in [0, 1).

    Returns:
        (S,) values, each within `TOLERANCE` or a few roundings.
    """
    return fixed_point(
        lambda value: _action_values(rows, reward, discount, value).max(axis=0),
        np.zeros(rows.shape[1]),
        discount,
    )


def fixed_point(
    backup: Callable[[FloatArray], FloatArray], value: FloatArray, discount: float
) -> FloatArray:
    """Solve v = L v for a monotone L with L(v + c) = L v + discount c.

    After a sweep v' = L v the solution lies between v' + c min(v' - v) and v' + c max(v' - v)
    with c = discount / (1 - discount) (Puterman 1994, Theorem 6.6.3), which bounds the error
    and gives the last correction. Needs memory for the values alone.

    Args:
        backup: L.
        value: where to begin.
        discount: in [0, 1).

    Returns:
        The values, each within `TOLERANCE` or a few roundings.
    """
    scale = discount / (1.0 - discount)
    while True:
        swept = backup(value)
        change = swept - value
        low, high = scale * change.min(), scale * change.max()
        rounding = 8 * np.finfo(np.float64).eps * np.abs(swept).max() * scale
        value = swept
        if high - low <= 2 * TOLERANCE + rounding:
            return np.asarray(value + (low + high) / 2)


def infinite_horizon_discount(model: TabularModel, discount: float | None) -> float:
    """Return the discount, the model's if none is given.

    Raises:
        ValueError: it is not in [0, 1).
    """
    chosen = model.discount if discount is None else discount
    if not 0.0 <= chosen < 1.0:
        raise ValueError(f"discount: {chosen}, an infinite horizon needs one in [0, 1)")
    return chosen


def _rows_of(rows: csr_array, model: TabularModel, action: int) -> csr_array:
    """Return the S rows of one action."""
    return rows[action * model.n_states : (action + 1) * model.n_states]


def _action_values(
    rows: csr_array, reward: FloatArray, discount: float, value: FloatArray
) -> FloatArray:
    """r_a + discount P_a v: (A, S)."""
    return np.asarray(reward + discount * (rows @ value).reshape(reward.shape))


def _policy_tables(model: TabularModel, policy: FloatArray) -> tuple[csr_array, FloatArray]:
    """Return the rows (S, S) and the rewards (1, S) of a policy (S, A) over states."""
    weights = csr_array(hstack([diags_array(column) for column in policy.T]))
    reward = (policy * model.expected_reward.T).sum(axis=1)
    return csr_array(weights @ model.transition_rows), reward[None]


def _uniform_policy(model: TabularModel) -> FloatArray:
    return np.full((model.n_states, model.n_actions), 1.0 / model.n_actions)
