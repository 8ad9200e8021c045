"""The best stochastic memoryless policy of one agent, by gradient ascent on its exact value."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax

from bnprl_envs.memoryless import Clock, Progress, check_limits, policy_table
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import infinite_horizon_discount
from bnprl_envs.sensor_chain import SensorChain, sensor_chain, solve_chain
from bnprl_envs.tables import FloatArray

_CLIMBS = 10
"""Deterministic local optima, the best of which begins a stochastic ascent."""
_NEAR = 4.0
"""Added to the logits of a deterministic policy's actions where stochastic ascent begins."""


class StochasticPolicy(NamedTuple):
    """A stochastic memoryless policy of one agent.

    Attributes:
        probabilities: (O + 1, A) action probabilities after each observation; the last row is
            for the first action.
        value: at the start, exactly.
    """

    probabilities: FloatArray
    value: float


def stochastic_memoryless_policy(
    model: TabularModel,
    *,
    restarts: int | None = 10,
    seconds: float | None = None,
    seed: int = 0,
    discount: float | None = None,
    initial: Sequence[int] | None = None,
    on_progress: Progress | None = None,
) -> StochasticPolicy:
    """Search the best stochastic memoryless policy of one agent.

    Ascent by L-BFGS on the exact value over the logits of softmax rows; the gradient takes one
    more solve with the transposed system. Every other restart, the first included, begins near
    the best of some deterministic local optima (of `memoryless_joint_policy`), the others at
    random. A local search: the best of the restarts is a lower bound of the best there is.

    Args:
        model: partially observed, of one agent.
        restarts: how often to begin; None: until the time is over.
        seconds: time to spend; None: until the restarts are done.
        seed: of the random logits.
        discount: instead of the model's.
        initial: (O + 1,) actions of a policy near which the first restart begins; what is
            returned is not worse.
        on_progress: called after every iteration.

    Returns:
        The probabilities and their value, which unpack as a pair.

    Raises:
        ValueError: the model has many agents or is fully observed, no limit is given or one is
            out of range, `initial` does not fit, or the discount is not below 1.
    """
    from bnprl_envs.coordinate_ascent import Ascent

    chosen = infinite_horizon_discount(model, discount)
    check_limits(restarts, seconds)
    if model.n_agents != 1:
        raise ValueError(f"model: {model.n_agents} agents, must be one")
    chain = sensor_chain(model)
    climbs = Ascent(chain, model.action_sizes, model.observation_sizes, chosen)
    random = np.random.default_rng(seed)
    climbs.restart(random, late=lambda: True)  # compiles it
    clock = Clock(seconds, on_progress)
    uniform = np.full((model.n_observations + 1, model.n_actions), 1.0 / model.n_actions)
    ascent = _LogitAscent(chain, chosen, clock, StochasticPolicy(uniform, -np.inf))
    if initial is not None:
        table = policy_table(model, 0, initial)
        ascent.best = StochasticPolicy(table, solve_chain(chain, table, chosen).value)
    for restart in itertools.count():
        if restart == restarts or (restart and clock.late()):
            break
        logits = random.normal(size=uniform.shape)
        if restart == 0 and initial is not None:
            logits += _NEAR * ascent.best.probabilities
        elif restart % 2 == 0:
            local = [climbs.restart(random, clock.late) for _ in range(_CLIMBS)]
            _, found = max(local, key=lambda climb: climb[0])
            logits[np.arange(len(logits)), found] += _NEAR
        ascent.climb(logits)
    return ascent.best


@dataclass
class _LogitAscent:
    """Ascent on the exact value over logits; remembers the best policy of all climbs."""

    chain: SensorChain
    discount: float
    clock: Clock
    best: StochasticPolicy

    def climb(self, logits: FloatArray) -> None:
        """Climb from logits (O + 1, A) until nothing is gained or the time is over."""

        def loss(flat: FloatArray) -> tuple[float, FloatArray]:
            policy = np.exp(log_softmax(flat.reshape(logits.shape), axis=1))
            value, gradient = _value_gradient(self.chain, policy, self.discount)
            if value > self.best.value:
                self.best = StochasticPolicy(policy, value)
            return -value, -gradient.ravel()

        def after_iteration(intermediate_result: object) -> None:
            self.clock.report(self.best.value)
            if self.clock.late():
                raise StopIteration

        minimize(
            loss,
            logits.ravel(),
            jac=True,
            method="L-BFGS-B",
            callback=after_iteration,
            options={"maxiter": 2000, "maxfun": 4000, "ftol": 1e-12, "gtol": 1e-9, "maxcor": 20},
        )


def _value_gradient(
    chain: SensorChain, policy: FloatArray, discount: float
) -> tuple[float, FloatArray]:
    """Return the value and its gradient in the logits (O + 1, A).

    dJ / dpi(a | o) = sum_y d(y) O(o | y) u(a, s_y) with d the discounted visits (Sutton et al.
    1999, the policy gradient theorem, here with exact sums).
    """
    value, action_values, visits = solve_chain(chain, policy, discount)
    after = chain.sensor.T @ (visits[:, None] * action_values[:, chain.state].T)
    first = action_values @ chain.start
    slope = np.vstack([after, first])
    mean = np.sum(policy * slope, axis=1, keepdims=True)
    return value, np.asarray(policy * (slope - mean))
