"""Environments as compiled code: how an episode begins and goes on, for loops that are compiled.

A world is a named tuple of numbers and arrays. Which functions serve it is decided by its type when
a loop is compiled, so that the loop needs no callback into Python and is cached on disk; with
`NUMBA_DISABLE_JIT=1` the same source runs as Python. A state is an array (D,) of floats, for a
tabular model (1,) with the number of the state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numba import njit
from numba.extending import overload

from bnprl_envs.inverted_pendulum import START, InvertedPendulumVectorEnv, integrate, push
from bnprl_envs.inverted_pendulum import outcome as pendulum_outcome
from bnprl_envs.puddle_world import GOAL, PuddleWorldVectorEnv, moved
from bnprl_envs.puddle_world import START as CORNER
from bnprl_envs.puddle_world import outcome as puddle_outcome
from bnprl_envs.sampling import ModelSampler, draw
from bnprl_envs.tabular_vector import TabularVectorEnv


class Pendulum(NamedTuple):
    """The inverted pendulum; `noise` is the largest disturbance, N."""

    noise: float


class Puddles(NamedTuple):
    """The puddle world; standard deviation of the noise, and whether it begins anywhere."""

    noise: float
    uniform_start: bool


def world_of(env: Any) -> NamedTuple | None:
    """Return a vector environment as a world; None where there is no compiled form.

    A tabular model must be fully observed.
    """
    if isinstance(env, InvertedPendulumVectorEnv):
        return Pendulum(env.noise)
    if isinstance(env, PuddleWorldVectorEnv):
        return Puddles(env.noise, env.uniform_start)
    if isinstance(env, TabularVectorEnv) and env.model.fully_observed:
        sampler: ModelSampler = env.model.sampler
        return sampler
    return None


@njit(cache=True)
def _begin_pendulum(world, state, rng):  # type: ignore[no-untyped-def]
    state[0], state[1] = START * (2.0 * rng.random() - 1.0), START * (2.0 * rng.random() - 1.0)


@njit(cache=True)
def _advance_pendulum(world, state, action, rng):  # type: ignore[no-untyped-def]
    disturbance = world.noise * (2.0 * rng.random() - 1.0)
    angle, velocity = integrate(state[0], state[1], push(action) + disturbance)
    reward, terminated = pendulum_outcome(state[0], angle)
    state[0], state[1] = angle, velocity
    return reward, terminated


@njit(cache=True)
def _begin_puddles(world, state, rng):  # type: ignore[no-untyped-def]
    state[0], state[1] = CORNER
    if world.uniform_start:
        state[0] = GOAL
        while state[0] + state[1] >= GOAL:
            state[0], state[1] = rng.random(), rng.random()


@njit(cache=True)
def _advance_puddles(world, state, action, rng):  # type: ignore[no-untyped-def]
    noise_x, noise_y = world.noise * rng.standard_normal(), world.noise * rng.standard_normal()
    state[0], state[1] = moved(state[0], state[1], action, noise_x, noise_y)
    return puddle_outcome(state[0], state[1])


@njit(cache=True)
def _begin_model(world, state, rng):  # type: ignore[no-untyped-def]
    state[0] = world.start.outcome[draw(world.start, 0, rng.random())]


@njit(cache=True)
def _advance_model(world, state, action, rng):  # type: ignore[no-untyped-def]
    move = draw(world.transition, action * world.n_states + int(state[0]), rng.random())
    end = world.transition.outcome[move]
    state[0] = end
    return world.reward[move, end if world.reward.shape[1] > 1 else 0], world.terminal[end]


_FUNCTIONS: dict[type, tuple[Callable[..., Any], Callable[..., Any]]] = {
    Pendulum: (_begin_pendulum, _advance_pendulum),
    Puddles: (_begin_puddles, _advance_puddles),
    ModelSampler: (_begin_model, _advance_model),
}


def begin(world: Any, state: Any, rng: Any) -> Any:
    """Draw the first state of an episode into `state`."""
    return _FUNCTIONS[type(world)][0](world, state, rng)


def advance(world: Any, state: Any, action: Any, rng: Any) -> Any:
    """Act once: change `state`; return the reward and whether the state is terminal."""
    return _FUNCTIONS[type(world)][1](world, state, action, rng)


@overload(begin)
def _begin(world, state, rng):  # type: ignore[no-untyped-def]
    function = _FUNCTIONS[world.instance_class][0]
    return lambda world, state, rng: function(world, state, rng)


@overload(advance)
def _advance(world, state, action, rng):  # type: ignore[no-untyped-def]
    function = _FUNCTIONS[world.instance_class][1]
    return lambda world, state, action, rng: function(world, state, action, rng)
