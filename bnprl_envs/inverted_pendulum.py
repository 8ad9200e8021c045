"""Inverted pendulum (Lagoudakis and Parr 2003): balance a pole on a cart by pushing the cart."""

from __future__ import annotations

import math

import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode
from numba import njit

from bnprl_envs.arguments import checked_noise
from bnprl_envs.continuous import ContinuousEnv, ContinuousVectorEnv
from bnprl_envs.rendering.pendulum import Pendulum
from bnprl_envs.tables import BoolArray, FloatArray
from bnprl_envs.vector_env import IntArray

PENDULUM_MASS = 2.0  # kg
CART_MASS = 8.0  # kg
LENGTH = 0.5  # m
GRAVITY = 9.8  # m/s^2
FORCE = 50.0  # N
NOISE = 10.0  # N
TIME_STEP = 0.1  # s
START = 0.2  # rad and rad/s
FALLEN = math.pi / 2  # rad
DISCOUNT = 0.95
N_ACTIONS = 3

_BOUND = np.array((math.pi, 10.0))
"""Of angle and velocity. The largest reachable ones, after the last step, are 2.39 and 9.29."""
_INVERSE_MASS = 1.0 / (PENDULUM_MASS + CART_MASS)


class InvertedPendulumEnv(ContinuousEnv):
    """Inverted pendulum: keep a pole upright on a cart that is pushed left or right.

    ## Description
    A pole of 2 kg and 0.5 m turns on a cart of 8 kg. The state is the pole's angle from the
    vertical and its angular velocity; the cart's place does not matter. A push lasts 0.1 s, in
    which the force on the cart, u newtons, is the action's and a disturbance uniform in
    [-10, 10], both constant. With a = 1 / (2 kg + 8 kg) the angle's acceleration is::

        g sin(angle) - a m l velocity^2 sin(2 angle) / 2 - a cos(angle) u
        -----------------------------------------------------------------
                      4 l / 3 - a m l cos(angle)^2

    integrated by one step of the classical Runge-Kutta method, whose error, in every reachable
    state, is below 3e-4 rad and 5e-3 rad/s.

    ## Action Space
    `Discrete(3)`: 0, 1, 2 push with -50, 0, +50 N. A positive force turns an upright pole
    towards negative angles.

    ## Observation Space
    `Box((-pi, -10), (pi, 10), (2,), float64)`: the state, angle (rad) and angular velocity
    (rad/s). No reachable state lies outside.

    ## Rewards
    |angle before| - |angle after|: what the step brings the pole nearer to the vertical.

    ## Starting State
    Angle and velocity uniform in [-0.2, 0.2].

    ## Episode End
    Termination when |angle| reaches pi / 2; truncation after 3000 steps.

    ## Arguments
    `noise=10.0`: the largest disturbance, N, in [0, 10].

    ## References
    Lagoudakis and Parr (2003), Least-squares policy iteration, JMLR 4: the dynamics and their
    constants. Chowdhary, Liu, Grande, Walsh, How and Carin (2014), Off-policy reinforcement
    learning with Gaussian processes, IEEE/CAA Journal of Automatica Sinica 1(3).

    ## Version History
    v0: initial version.

    Args:
        noise: largest disturbance, N.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None, "ansi", "rgb_array" or "human".

    Attributes:
        discount: 0.95.

    Raises:
        ValueError: an argument is out of range.
    """

    discount = DISCOUNT
    action_names = ("push left", "no push", "push right")
    state_names = ("angle", "velocity")

    def __init__(
        self,
        noise: float = NOISE,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.noise = checked_noise(noise, largest=NOISE)
        super().__init__(
            _observation_space(),
            N_ACTIONS,
            max_episode_steps=max_episode_steps,
            render_mode=render_mode,
        )

    def _start(self) -> tuple[float, ...]:
        return tuple(self.np_random.uniform(-START, START, 2).tolist())

    def _move(self, action: int) -> tuple[tuple[float, ...], float, bool]:
        disturbance = self.np_random.uniform(-self.noise, self.noise)
        angle, velocity = self._state
        angle_t, velocity_t = integrate(angle, velocity, push(action) + disturbance)
        return (angle_t, velocity_t), *outcome(angle, angle_t)

    def _make_scene(self) -> Pendulum:
        return Pendulum(fallen=FALLEN, pushes=[push(action) for action in range(N_ACTIONS)])


class InvertedPendulumVectorEnv(ContinuousVectorEnv):
    """`num_envs` independent inverted pendulums, with the semantics of Gymnasium's SyncVectorEnv.

    Everything is as `InvertedPendulumEnv` describes it, with a leading axis of copies; autoreset
    modes and `reset_mask` are those of `NativeVectorEnv`. All copies share one random stream.

    Args:
        num_envs: number of copies.
        noise: largest disturbance, N, in [0, 10].
        max_episode_steps: steps before truncation; None: no limit.
        autoreset_mode: the mode or its name ("NextStep", "SameStep", "Disabled").
        render_mode: None.

    Attributes:
        discount: 0.95.
        autoreset_mode: also in `metadata`.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        num_envs: int = 1,
        noise: float = NOISE,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        self.noise = checked_noise(noise, largest=NOISE)
        super().__init__(
            num_envs,
            _observation_space(),
            Discrete(N_ACTIONS),
            discount=DISCOUNT,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )

    def _starts(self, n: int) -> FloatArray:
        return self.np_random.uniform(-START, START, (n, 2))

    def _move(
        self, actions: IntArray, states: FloatArray, rewards: FloatArray, terminated: BoolArray
    ) -> None:
        disturbances = self.np_random.uniform(-self.noise, self.noise, self.num_envs)
        _move_batch(actions, disturbances, self._finished, states, rewards, terminated)


@njit(cache=True)
def push(action):  # type: ignore[no-untyped-def]
    """Return the force of an action, N."""
    return FORCE * (action - 1)


@njit(cache=True)
def acceleration(angle, velocity, force):  # type: ignore[no-untyped-def]
    """Return the angular acceleration, rad/s^2 (Wang, Tanaka and Griffin 1996)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    inertia = _INVERSE_MASS * PENDULUM_MASS * LENGTH  # sin(2 angle) / 2 is sine * cosine below
    torque = GRAVITY * sine - inertia * velocity**2 * sine * cosine - _INVERSE_MASS * cosine * force
    return torque / (4.0 * LENGTH / 3.0 - inertia * cosine**2)


@njit(cache=True)
def integrate(angle, velocity, force):  # type: ignore[no-untyped-def]
    """Return angle and velocity after `TIME_STEP` of a constant force: one Runge-Kutta step."""
    half, sixth = TIME_STEP / 2.0, TIME_STEP / 6.0
    v1, a1 = velocity, acceleration(angle, velocity, force)
    v2, a2 = velocity + half * a1, acceleration(angle + half * v1, velocity + half * a1, force)
    v3, a3 = velocity + half * a2, acceleration(angle + half * v2, velocity + half * a2, force)
    v4 = velocity + TIME_STEP * a3
    a4 = acceleration(angle + TIME_STEP * v3, v4, force)
    return (
        angle + sixth * (v1 + 2.0 * (v2 + v3) + v4),
        velocity + sixth * (a1 + 2.0 * (a2 + a3) + a4),
    )


@njit(cache=True)
def outcome(angle_tm1, angle_t):  # type: ignore[no-untyped-def]
    """Return the reward of a step from one angle to another, and whether the pole has fallen."""
    return abs(angle_tm1) - abs(angle_t), abs(angle_t) >= FALLEN


@njit(cache=True)
def _move_batch(actions, disturbances, finished, states, rewards, terminated):  # type: ignore[no-untyped-def]
    for i in range(actions.size):
        if finished[i]:
            continue
        angle, velocity = states[i, 0], states[i, 1]
        angle_t, velocity_t = integrate(angle, velocity, push(actions[i]) + disturbances[i])
        rewards[i], terminated[i] = outcome(angle, angle_t)
        states[i, 0], states[i, 1] = angle_t, velocity_t


def _observation_space() -> Box:
    return Box(-_BOUND, _BOUND, dtype=np.float64)
