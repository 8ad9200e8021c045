"""Learners of action values as compiled code, and the loop that lets them act and learn.

A learner's state is a named tuple of arrays and numbers. Which functions serve it is decided by its
type when a loop is compiled, as for `bnprl_envs.worlds`. A learner's module registers them::

    register(Type, values, learn)

`values(learner, x)` returns the values (A,) at a point by which it is greedy when it acts, and
`learn(learner, x, a, r, x_t, terminated, t)` learns the t-th transition, counted from 0, in place,
and returns the absolute error of the prediction.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from bnprl_agents.agent import Metrics
from bnprl_agents.episodes import FloatArray
from bnprl_agents.training import Budget, Progress, check_batch
from bnprl_agents.value_learner import Transitions, ValueAgent
from bnprl_envs.horizon import horizon_of
from bnprl_envs.worlds import advance, begin, world_of

REPORTS = 200
"""Reports of a compiled run whose budget is given in steps."""
NO_LIMIT = np.iinfo(np.int64).max

_FUNCTIONS: dict[type, tuple[Callable[..., Any], Callable[..., Any]]] = {}


class CompiledValueAgent(ValueAgent):
    """A learner of action values whose steps are compiled, one transition after the other."""

    @property
    @abc.abstractmethod
    def learner(self) -> NamedTuple:
        """The state, of a registered type, whose arrays the compiled functions change."""

    @abc.abstractmethod
    def report(self, error: float) -> Metrics:
        """Return what an update reports, given its mean absolute error."""

    @property
    def explores(self) -> bool:
        """Whether random actions are taken with probability epsilon."""
        return True

    @property
    def compiles(self) -> bool:
        """Whether whole stretches of training may be compiled too."""
        return True

    def behaviour_values(self, points: FloatArray) -> FloatArray:
        """Return the values (n, A) by which `act` is greedy when it does not explore."""
        values: FloatArray = values_at(self.learner, points, self.n_actions)
        return values

    def exploring_probability(self) -> float:
        """Return epsilon of the next step; 0 where nothing is explored at random."""
        return super().exploring_probability() if self.explores else 0.0

    def learn(self, transitions: Transitions) -> Metrics:
        """Learn transitions in order."""
        arrays = (np.ascontiguousarray(part) for part in transitions)
        return self.report(float(learn_in_order(self.learner, self.steps, *arrays)))

    def train_in(self, env: Any, budget: Budget, seed: int) -> Iterator[Progress]:
        """Learn from every step, compiled with the world if it is one; see `Agent.train_in`."""
        check_batch(env)
        world = world_of(env)
        if world is None or not self.compiles or env.num_envs != 1:
            return super().train_in(env, budget, seed)
        return self._living(world, horizon_of(env) or NO_LIMIT, budget, np.random.default_rng(seed))

    def _living(
        self, world: tuple[Any, ...], horizon: int, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Progress]:
        """Act and learn in a world; reports after every episode or every few steps."""
        place = Place(self.features.points, self.features.offset, self.features.range)
        exponent = self.config.exploration_exponent if self.explores else -1.0
        state, elapsed = np.zeros(place.offset.size), np.zeros(1, dtype=np.int64)
        done, taken, most_steps, most_episodes = 0, 0, NO_LIMIT, 1
        while budget.allows(done, taken):
            if budget.steps is not None:
                most_steps = min(max(1, budget.steps // REPORTS), budget.steps - taken)
                most_episodes = NO_LIMIT
            steps, episodes, error = act_and_learn(
                self.learner,
                world,
                place,
                exponent,
                horizon,
                state,
                elapsed,
                self.steps,
                most_steps,
                most_episodes,
                self.rng,
                rng,
            )
            self.steps += steps
            done, taken = done + episodes, taken + steps
            yield Progress(done, taken, self.report(error))


def register(kind: type, values: Callable[..., Any], learn: Callable[..., Any]) -> None:
    """Say which compiled functions serve a type of learner."""
    _FUNCTIONS[kind] = values, learn


def act_values(learner: Any, x: Any) -> Any:
    """Return the values (A,) at a point by which a learner acts."""
    return _FUNCTIONS[type(learner)][0](learner, x)


def learn_one(learner: Any, x: Any, a: Any, r: Any, x_t: Any, terminated: Any, t: Any) -> Any:
    """Learn the t-th transition in place; return the absolute error of the prediction."""
    return _FUNCTIONS[type(learner)][1](learner, x, a, r, x_t, terminated, t)


@overload(act_values)
def _act_values(learner, x):  # type: ignore[no-untyped-def]
    function = _FUNCTIONS[learner.instance_class][0]
    return lambda learner, x: function(learner, x)


@overload(learn_one)
def _learn_one(learner, x, a, r, x_t, terminated, t):  # type: ignore[no-untyped-def]
    function = _FUNCTIONS[learner.instance_class][1]
    return lambda learner, x, a, r, x_t, terminated, t: function(
        learner, x, a, r, x_t, terminated, t
    )


@njit(cache=True)
def values_at(learner, points, n_actions):  # type: ignore[no-untyped-def]
    """Return the values (n, A) at points (n, D) by which a learner acts."""
    values = np.empty((points.shape[0], n_actions))
    for i in range(points.shape[0]):
        values[i] = act_values(learner, points[i])
    return values


@njit(cache=True)
def learn_in_order(  # type: ignore[no-untyped-def]
    learner, steps, points, actions, rewards, next_points, terminated
):
    """Learn transitions, before which there were `steps`; return the mean absolute error."""
    total = 0.0
    for i in range(actions.size):
        total += learn_one(
            learner,
            points[i],
            actions[i],
            rewards[i],
            next_points[i],
            terminated[i],
            steps + i,
        )
    return total / actions.size


class Place(NamedTuple):
    """How a state becomes a point: a row of `cells` if it has any, else (s - offset) / range."""

    cells: FloatArray
    offset: FloatArray
    range: FloatArray


@njit(cache=True)
def located(place, state):  # type: ignore[no-untyped-def]
    """Return the point (D,) of a state."""
    if place.cells.shape[0] > 0:
        return place.cells[int(state[0])].copy()
    return (state - place.offset) / place.range


@njit(cache=True)
def best_action(values, rng):  # type: ignore[no-untyped-def]
    """Return an action of the largest value, ties broken uniformly."""
    best, ties = 0, 1.0
    for a in range(1, values.size):
        if values[a] > values[best]:
            best, ties = a, 1.0
        elif values[a] == values[best]:
            ties += 1.0
            if rng.random() * ties < 1.0:
                best = a
    return best


@njit(cache=True)
def act_and_learn(  # type: ignore[no-untyped-def]
    learner, world, place, exponent, horizon, state, elapsed, t, steps, episodes, rng, world_rng
):
    """Act and learn for some steps, or until some episodes end; one copy of the environment.

    Args:
        learner: changed in place.
        world: where it acts.
        place: of states.
        exponent: b of the exploring probability t^-b; negative: none.
        horizon: steps before an episode is truncated.
        state: (D,) of the episode under way; changed in place.
        elapsed: (1,) its steps so far; 0 begins a new one. Changed in place.
        t: transitions learned before.
        steps: stop after so many.
        episodes: stop after so many have ended.
        rng: of the learner.
        world_rng: of the world.

    Returns:
        Steps, episodes ended, and the mean absolute error.
    """
    taken, ended, total = 0, 0, 0.0
    while taken < steps and ended < episodes:
        if elapsed[0] == 0:
            begin(world, state, world_rng)
        x = located(place, state)
        values = act_values(learner, x)
        if exponent >= 0.0 and rng.random() < (1.0 + t + taken) ** -exponent:
            action = min(int(rng.random() * values.size), values.size - 1)
        else:
            action = best_action(values, rng)
        reward, terminated = advance(world, state, action, world_rng)
        total += learn_one(learner, x, action, reward, located(place, state), terminated, t + taken)
        taken += 1
        elapsed[0] += 1
        if terminated or elapsed[0] >= horizon:
            elapsed[0] = 0
            ended += 1
    return taken, ended, total / max(taken, 1)
