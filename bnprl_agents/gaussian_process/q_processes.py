"""Action values as sparse online Gaussian processes, compiled: Algorithm 2's measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.compiled_values import register
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.basis import Basis, mean, mean_and_variance
from bnprl_agents.gaussian_process.online_update import update


class Prior(NamedTuple):
    """What the processes assume.

    Attributes:
        mean: of every value.
        bandwidth: (D,) of the kernel.
        amplitude: prior variance.
        noise: variance of a measurement.
        tolerance: novelty that a basis point needs.
        budget: basis points at most.
        forgetting: factor of C before each measurement.
    """

    mean: float
    bandwidth: FloatArray
    amplitude: float
    noise: float
    tolerance: float
    budget: int
    forgetting: float


class Inputs(NamedTuple):
    """Where Q(s, a) is found: process `owner[a]` at the point [s, code[a]].

    Attributes:
        owner: (A,).
        code: (A, 0) per action, (A, 1) joint.
    """

    owner: IntArray
    code: FloatArray


class Processes(NamedTuple):
    """Everything that the compiled functions read and change.

    Attributes:
        basis: the processes' states, with a leading axis of processes.
        inputs: where Q(s, a) is found.
        prior: what the processes assume.
        optimism: variances that are added to a mean.
        discount: gamma.
    """

    basis: Basis
    inputs: Inputs
    prior: Prior
    optimism: float
    discount: float


@njit(cache=True)
def process(basis, a):  # type: ignore[no-untyped-def]
    """Return the state of one process: views of the arrays of all."""
    return Basis(
        basis.points[a],
        basis.weights[a],
        basis.covariance[a],
        basis.precision[a],
        basis.kernel[a],
        basis.size[a],
    )


@njit(cache=True)
def joined(point, code, bandwidth):  # type: ignore[no-untyped-def]
    """Return [s, code] in units of the bandwidths."""
    z = np.empty(bandwidth.size)
    for d in range(z.size):
        z[d] = (point[d] if d < point.size else code[d - point.size]) / bandwidth[d]
    return z


@njit(cache=True)
def q_value(processes, point, action):  # type: ignore[no-untyped-def]
    """Return m(s, a) + optimism var(s, a)."""
    basis, inputs, prior, optimism, _ = processes
    z = joined(point, inputs.code[action], prior.bandwidth)
    state = process(basis, inputs.owner[action])
    if optimism == 0.0:
        return prior.mean + mean(state, z, prior.amplitude)
    m, v = mean_and_variance(state, z, prior.amplitude)
    return prior.mean + m + optimism * v


@njit(cache=True)
def action_values(processes, point):  # type: ignore[no-untyped-def]
    """Return m(s, a) + optimism var(s, a) of every action, (A,)."""
    values = np.empty(processes.inputs.owner.size)
    for a in range(values.size):
        values[a] = q_value(processes, point, a)
    return values


@njit(cache=True)
def learn_measurement(processes, x, a, r, x_t, terminated, t):  # type: ignore[no-untyped-def]
    """Measure y = r + gamma max_b [m(s', b) + optimism var(s', b)] of Q(s, a); (3.5)."""
    basis, inputs, prior, _, discount = processes
    y = r
    if not terminated:
        y += discount * action_values(processes, x_t).max()
    z = joined(x, inputs.code[a], prior.bandwidth)
    state = process(basis, inputs.owner[a])
    error = update(
        state,
        z,
        y - prior.mean,
        prior.amplitude,
        prior.noise,
        prior.tolerance,
        prior.budget,
        prior.forgetting,
    )
    return abs(error)


register(Processes, action_values, learn_measurement)
