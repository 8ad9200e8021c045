"""What every learner of action values shares: acting, recording, saving."""

from __future__ import annotations

import abc
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np

from bnprl_agents.agent import Agent, Metrics
from bnprl_agents.copies import check_copies, integers, require_alive
from bnprl_agents.episodes import BoolArray, FloatArray, IntArray, check_range
from bnprl_agents.features import Features
from bnprl_agents.policy_files import Arrays, count, taken
from bnprl_agents.settings import check_entries


class Transitions(NamedTuple):
    """n transitions, in the order in which they were observed.

    Attributes:
        points: (n, D) the observations before, as points.
        actions: (n,) indices from 0.
        rewards: (n,).
        next_points: (n, D) the true next observations.
        terminated: (n,) where nothing is earned afterwards. A truncated episode would have gone
            on: its last target is bootstrapped.
    """

    points: FloatArray
    actions: IntArray
    rewards: FloatArray
    next_points: FloatArray
    terminated: BoolArray


class ValueAgent(Agent):
    """Base of the learners of Q(s, a): one agent, Discrete or Box observations, Discrete actions.

    Subclasses say how transitions change the values (`learn`) and what the values are. Ties are
    broken at random, by `predict` too unless it is deterministic: then the first action wins.

    Attributes:
        features: observation -> point.
        steps: transitions learned so far.

    Raises:
        ValueError: a space that the agent cannot use, as said above, or a Box with infinite ends
            where the settings give none.
    """

    preferred_copies = 1
    needs_distance: ClassVar[bool] = True
    """Whether a Discrete observation without a grid is the corner of a simplex, not a number."""

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        if not isinstance(action_space, gym.spaces.Discrete):
            raise ValueError(f"action_space: {action_space}, must be Discrete")
        settings = self.config
        self.features = Features(
            observation_space,
            settings.low,
            settings.high,
            settings.grid_columns,
            numbered=not self.needs_distance,
        )
        self.n_actions = int(action_space.n)
        check_entries("action_space", self.n_actions)
        self._first_action = int(action_space.start)
        self.steps = 0
        self._points = np.zeros((0, self.features.dimensions))
        self._pending: list[Transitions] = []
        self._alive = np.zeros(0, dtype=np.bool_)

    @abc.abstractmethod
    def values(self, points: FloatArray) -> FloatArray:
        """Return the learned values (n, A) at points (n, D)."""

    @abc.abstractmethod
    def learn(self, transitions: Transitions) -> Metrics:
        """Change the values by transitions."""

    @abc.abstractmethod
    def learned_arrays(self) -> Arrays:
        """What was learned."""

    @abc.abstractmethod
    def restore_learned(self, arrays: Arrays) -> None:
        """Take over what `learned_arrays` gave.

        Raises:
            ValueError: an array has the wrong shape.
        """

    def behaviour_values(self, points: FloatArray) -> FloatArray:
        """Return the values (n, A) by which `act` is greedy when it does not explore."""
        return self.values(points)

    def exploring_probability(self) -> float:
        """Return epsilon of the next step: t^-b at the t-th."""
        return float((1.0 + self.steps) ** -self.config.exploration_exponent)

    def action_values(self, observation: Any) -> FloatArray:
        """Return the learned values (n, A) of observations."""
        return self.values(self.features(observation))

    def greedy_policy(self, observation: Any) -> FloatArray:
        """Return the learned policy (n, A) as probabilities: uniform over the best actions."""
        best = _is_best(self.action_values(observation))
        probabilities: FloatArray = best / best.sum(axis=1, keepdims=True)
        return probabilities

    def reset(self, observation: Any, mask: BoolArray | None = None) -> None:
        """Begin new episodes; see `Agent.reset`. The number of copies may change if all begin."""
        points = self.features(observation)
        begun = np.ones(len(points), dtype=np.bool_) if mask is None else np.asarray(mask, bool)
        if begun.shape != (len(points),):
            raise ValueError(f"mask: shape {begun.shape}, must be ({len(points)},)")
        if len(points) != len(self._alive):
            if not begun.all():
                raise ValueError(f"{len(points)} copies, was {len(self._alive)}: reset all of them")
            self._points, self._alive = points.copy(), begun.copy()
        self._points[begun] = points[begun]
        self._alive |= begun

    def act(self, observation: Any) -> Any:
        """Act greedily, or with probability epsilon at random; see `Agent.act`."""
        require_alive(self._alive)
        points = self.features(observation)
        check_copies(len(self._alive), observation=points[:, 0])
        chosen = _best(self.behaviour_values(points), self.rng)
        exploring = self.rng.random(len(chosen)) < self.exploring_probability()
        random = self.rng.integers(self.n_actions, size=len(chosen))
        return self._external(np.where(exploring, random, chosen), observation)

    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition of every copy; see `Agent.observe`."""
        require_alive(self._alive)
        rewards = np.atleast_1d(np.asarray(reward, dtype=np.float64))
        if not np.isfinite(rewards).all():
            raise ValueError(f"reward: {rewards[~np.isfinite(rewards)][0]}, must be finite")
        points, ended = self.features(observation), np.atleast_1d(np.asarray(terminated, bool))
        actions, cut = self._indices(action), np.atleast_1d(np.asarray(truncated, bool))
        check_copies(
            len(self._alive),
            action=actions,
            reward=rewards,
            observation=points[:, 0],
            terminated=ended,
            truncated=cut,
        )
        self._pending.append(Transitions(self._points, actions, rewards, points, ended))
        self._points = points.copy()
        self._alive = ~(ended | cut)

    def update(self) -> Metrics:
        """Learn from every transition observed since the last update; see `Agent.update`."""
        if not self._pending:
            return {}
        transitions = self._pending[0]
        if len(self._pending) > 1:
            transitions = Transitions(*map(np.concatenate, zip(*self._pending, strict=True)))
        self._pending = []
        metrics = self.learn(transitions)
        self.steps += len(transitions.actions)
        return metrics

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Act greedily by the learned values; see `Agent.predict`. There is no state."""
        values = self.action_values(observation)
        chosen = values.argmax(axis=1) if deterministic else _best(values, self.predict_rng)
        return self._external(chosen, observation), None

    def state_arrays(self) -> Arrays:
        """What was learned, and the transitions under way."""
        arrays: Arrays = {"points": self._points, "alive": self._alive}
        if self._pending:
            together = Transitions(*map(np.concatenate, zip(*self._pending, strict=True)))
            arrays |= {f"pending_{name}": array for name, array in together._asdict().items()}
        return arrays | self.learned_arrays()

    def counters(self) -> dict[str, Any]:
        """The number of transitions learned."""
        return {"steps": self.steps}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        self.steps = count("steps", counters["steps"])
        copies, dimensions = len(arrays["alive"]), self.features.dimensions
        self._points = taken(arrays, "points", (copies, dimensions))
        self._alive = taken(arrays, "alive", (copies,)).astype(np.bool_)
        if "pending_actions" in arrays:
            pending = restored_transitions(arrays, "pending_", dimensions, self.n_actions)
            self._pending = [pending]
        self.restore_learned(arrays)

    def _indices(self, action: Any) -> IntArray:
        indices: IntArray = integers("action", np.atleast_1d(action)) - self._first_action
        if ((indices < 0) | (indices >= self.n_actions)).any():
            raise ValueError(f"action: {action} lies outside {self.action_space}")
        return indices

    def _external(self, indices: IntArray, observation: Any) -> Any:
        actions = indices + self._first_action
        return actions if self.features.batched(observation) else int(actions[0])


def restored_transitions(
    arrays: Arrays, prefix: str, dimensions: int, n_actions: int
) -> Transitions:
    """Return transitions of a policy file, whose arrays' names begin with a prefix.

    Raises:
        ValueError: their shapes disagree, or an action does not exist.
    """
    n = len(arrays[f"{prefix}actions"])
    return Transitions(
        taken(arrays, f"{prefix}points", (n, dimensions)),
        restored_actions(arrays, f"{prefix}actions", n_actions),
        taken(arrays, f"{prefix}rewards", (n,)),
        taken(arrays, f"{prefix}next_points", (n, dimensions)),
        taken(arrays, f"{prefix}terminated", (n,)).astype(np.bool_),
    )


def restored_actions(arrays: Arrays, name: str, n_actions: int) -> IntArray:
    """Return action indices (n,) of a policy file.

    Raises:
        ValueError: there is no such action.
    """
    actions: IntArray = taken(arrays, name, (len(arrays[name]),)).astype(np.int64)
    check_range(name, actions, n_actions)
    return actions


def check_exponent(name: str, value: float) -> None:
    """Check the exponent of a schedule t^-b.

    Raises:
        ValueError: it is negative.
    """
    if not 0.0 <= value < np.inf:
        raise ValueError(f"{name}: {value}, must not be negative")


def _is_best(values: FloatArray) -> BoolArray:
    best: BoolArray = values == values.max(axis=1, keepdims=True)
    return best


def _best(values: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return the best action of each row of (n, A), ties broken uniformly."""
    best = _is_best(values)
    if best.sum() == len(values):
        first: IntArray = best.argmax(axis=1)
        return first
    chosen: IntArray = np.where(best, rng.random(values.shape), -1.0).argmax(axis=1)
    return chosen
