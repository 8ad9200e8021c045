"""Puddle world (Boyan and Moore 1995): walk to a corner around two puddles."""

from __future__ import annotations

import math

import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode
from numba import njit

from bnprl_envs.arguments import checked_flag, checked_noise
from bnprl_envs.continuous import ContinuousEnv, ContinuousVectorEnv
from bnprl_envs.rendering.puddles import Puddles
from bnprl_envs.tables import BoolArray, FloatArray
from bnprl_envs.vector_env import IntArray

MOVES = ((0.0, 0.05), (0.0, -0.05), (0.05, 0.0), (-0.05, 0.0))  # north, south, east, west
PUDDLES = ((0.1, 0.75, 0.45, 0.75), (0.45, 0.4, 0.45, 0.8))  # x, y of both ends of the axis
RADIUS = 0.1
PENALTY = 400.0  # per unit of depth
GOAL = 1.9  # of x + y
START = (0.05, 0.05)
NOISE = 0.01
DISCOUNT = 0.99


class PuddleWorldEnv(ContinuousEnv):
    """Puddle world: cross the unit square to its far corner without getting wet.

    ## Description
    A point in the unit square moves 0.05 in a compass direction, plus Gaussian noise of standard
    deviation 0.01 in each coordinate, and is stopped by the border (its coordinates are clipped).
    Two puddles are in the way: all points within 0.1 of the segments (.1, .75)-(.45, .75) and
    (.45, .4)-(.45, .8). The depth of a point in a puddle is its distance to the edge, 0.1 less
    the distance to the segment; where both puddles overlap, the greater depth counts.

    ## Action Space
    `Discrete(4)`: 0 north (+y), 1 south, 2 east (+x), 3 west.

    ## Observation Space
    `Box(0, 1, (2,), float64)`: the state, x and y.

    ## Rewards
    By the position after the move: 0 in the goal, else -1 - 400 depth. At worst -41.

    ## Starting State
    (0.05, 0.05): bottom left, one move from either border.

    ## Episode End
    Termination in the goal, x + y >= 1.9; truncation after 1000 steps.

    ## Arguments
    `uniform_start=False`: with True an episode begins uniformly outside the goal, puddles
    included. `noise=0.01`: standard deviation of the noise, in [0, 1].

    ## References
    Boyan and Moore (1995), Generalization in reinforcement learning: safely approximating the
    value function, NIPS 7. Sutton (1996), Generalization in reinforcement learning: successful
    examples using sparse coarse coding, NIPS 8: these puddles and this penalty. Chowdhary, Liu,
    Grande, Walsh, How and Carin (2014), Off-policy reinforcement learning with Gaussian
    processes, IEEE/CAA Journal of Automatica Sinica 1(3).

    ## Version History
    v0: initial version.

    Args:
        uniform_start: whether episodes begin anywhere outside the goal.
        noise: standard deviation of the noise in each coordinate.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None, "ansi", "rgb_array" or "human".

    Attributes:
        discount: 0.99.

    Raises:
        ValueError: an argument is out of range.
    """

    discount = DISCOUNT
    action_names = ("north", "south", "east", "west")
    state_names = ("x", "y")

    def __init__(
        self,
        uniform_start: bool = False,
        noise: float = NOISE,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.uniform_start = checked_flag("uniform_start", uniform_start)
        self.noise = checked_noise(noise, largest=1.0)
        super().__init__(
            _observation_space(),
            len(MOVES),
            max_episode_steps=max_episode_steps,
            render_mode=render_mode,
        )

    def _start(self) -> tuple[float, ...]:
        return tuple(starts(1, self.uniform_start, self.np_random)[0].tolist())

    def _move(self, action: int) -> tuple[tuple[float, ...], float, bool]:
        noise_x, noise_y = (self.noise * self.np_random.standard_normal(2)).tolist()
        x, y = self._state
        x_t, y_t = moved(x, y, action, noise_x, noise_y)
        return (x_t, y_t), *outcome(x_t, y_t)

    def _make_scene(self) -> Puddles:
        return Puddles(PUDDLES, RADIUS, GOAL)


class PuddleWorldVectorEnv(ContinuousVectorEnv):
    """`num_envs` independent puddle worlds, with the semantics of Gymnasium's SyncVectorEnv.

    Everything is as `PuddleWorldEnv` describes it, with a leading axis of copies; autoreset modes
    and `reset_mask` are those of `NativeVectorEnv`. All copies share one random stream.

    Args:
        num_envs: number of copies.
        uniform_start: whether episodes begin anywhere outside the goal.
        noise: standard deviation of the noise in each coordinate.
        max_episode_steps: steps before truncation; None: no limit.
        autoreset_mode: the mode or its name ("NextStep", "SameStep", "Disabled").
        render_mode: None.

    Attributes:
        discount: 0.99.
        autoreset_mode: also in `metadata`.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        num_envs: int = 1,
        uniform_start: bool = False,
        noise: float = NOISE,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        self.uniform_start = checked_flag("uniform_start", uniform_start)
        self.noise = checked_noise(noise, largest=1.0)
        super().__init__(
            num_envs,
            _observation_space(),
            Discrete(len(MOVES)),
            discount=DISCOUNT,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )

    def _starts(self, n: int) -> FloatArray:
        return starts(n, self.uniform_start, self.np_random)

    def _move(
        self, actions: IntArray, states: FloatArray, rewards: FloatArray, terminated: BoolArray
    ) -> None:
        noise = self.noise * self.np_random.standard_normal((self.num_envs, 2))
        _move_batch(actions, noise, self._finished, states, rewards, terminated)


def starts(n: int, uniform: bool, rng: np.random.Generator) -> FloatArray:
    """Return n starting positions (n, 2): `START`, or uniform outside the goal (by rejection)."""
    if not uniform:
        return np.tile(START, (n, 1))
    points = rng.random((n, 2))
    while (inside := points.sum(axis=1) >= GOAL).any():
        points[inside] = rng.random((np.count_nonzero(inside), 2))
    return points


@njit(cache=True)
def depth(x, y):  # type: ignore[no-untyped-def]
    """Return how far below the edge of the deeper puddle a point lies; 0 outside."""
    nearest = RADIUS
    for x0, y0, x1, y1 in PUDDLES:
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / ((x1 - x0) ** 2 + (y1 - y0) ** 2)
        along = min(max(along, 0.0), 1.0)
        nearest = min(nearest, math.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0)))
    return RADIUS - nearest


@njit(cache=True)
def moved(x, y, action, noise_x, noise_y):  # type: ignore[no-untyped-def]
    """Return the position after a move, clipped to the unit square."""
    step_x, step_y = MOVES[action]
    return (
        min(max(x + step_x + noise_x, 0.0), 1.0),
        min(max(y + step_y + noise_y, 0.0), 1.0),
    )


@njit(cache=True)
def outcome(x, y):  # type: ignore[no-untyped-def]
    """Return the reward of arriving at a position, and whether it is in the goal."""
    if x + y >= GOAL:
        return 0.0, True
    return -1.0 - PENALTY * depth(x, y), False


@njit(cache=True)
def _move_batch(actions, noise, finished, states, rewards, terminated):  # type: ignore[no-untyped-def]
    for i in range(actions.size):
        if finished[i]:
            continue
        x, y = moved(states[i, 0], states[i, 1], actions[i], noise[i, 0], noise[i, 1])
        rewards[i], terminated[i] = outcome(x, y)
        states[i, 0], states[i, 1] = x, y


def _observation_space() -> Box:
    return Box(0.0, 1.0, (2,), dtype=np.float64)
