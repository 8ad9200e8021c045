"""The one call that trains any agent in any environment, and the loop that steps it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

if TYPE_CHECKING:
    from bnprl_agents.agent import Agent


@dataclass(frozen=True)
class Progress:
    """How far training has come.

    Attributes:
        episodes: episodes finished so far.
        steps: environment steps taken so far, over all copies.
        metrics: what the last update reported; {} between updates.
        reward: earned while learning, not discounted, over all steps; None where nobody counts.
        returned: mean discounted return of the episodes learned from; None where nobody counts.
    """

    episodes: int
    steps: int
    metrics: dict[str, float] = field(default_factory=dict)
    reward: float | None = None
    returned: float | None = None


@dataclass(frozen=True)
class Budget:
    """How long to train: so many finished episodes, or so many environment steps over all copies.

    Raises:
        ValueError: it is not given by exactly one positive number.
    """

    episodes: int | None = None
    steps: int | None = None

    def __post_init__(self) -> None:
        given = self.episodes if self.steps is None else self.steps
        if (self.episodes is None) == (self.steps is None) or given is None or given < 1:
            raise ValueError(
                f"episodes: {self.episodes}, steps: {self.steps}; give one of them, at least 1"
            )

    def allows(self, episodes: int, steps: int) -> bool:
        """Whether something is left after so much."""
        if self.episodes is not None:
            return episodes < self.episodes
        return self.steps is not None and steps < self.steps

    def fits(self, steps: int) -> bool:
        """Whether so many steps in all are within the budget."""
        return self.steps is None or steps <= self.steps


def train(
    agent: Agent,
    env: gym.vector.VectorEnv[Any, Any, Any],
    *,
    seed: int,
    episodes: int | None = None,
    steps: int | None = None,
) -> Iterator[Progress]:
    """Train an agent until the budget is spent; yields after every update.

    How is the agent's own affair (`Agent.train_in`). Where the environment is tabular and the agent
    learns controllers or belief policies, whole episodes are sampled by the compiled rollout
    instead of stepping copies; the two agree in law. A learner of action values that learns from
    every step, with one copy, in a world of `bnprl_envs.worlds`, is compiled with that world
    likewise. `ControllerSearch` makes a simulator of the environment (`simulator_of`), to which it
    hands its own seeds; what it has under way when the budget ends is lost. All others step the
    copies.

    Args:
        agent: learns in place.
        env: a vector environment whose autoreset is disabled; of a team, a batch that exchanges
            arrays (n_envs, N). For `ControllerSearch` a PettingZoo parallel environment will do.
        seed: of the environment.
        episodes: budget of finished episodes. Copies that are stepped may pass it by the episodes
            that end in the same step.
        steps: budget of environment steps over all copies, never exceeded: the last update
            learns from the whole episodes that still fit. Give one of the two.

    Raises:
        ValueError: the budget is not given by exactly one positive number, autoreset is on, the
            model has rewards that the agent cannot use, or a controller learner's discount is 1
            and episodes may last for ever.
    """
    return agent.train_in(env, Budget(episodes, steps), seed)


def check_batch(env: Any) -> None:
    """Check that an environment is a batch that waits to be reset.

    Raises:
        ValueError: it is not.
    """
    if not hasattr(env, "num_envs"):
        raise ValueError(
            f"env: {type(env).__name__} is no batch; gym.make_vec(id, num_envs=1, "
            'autoreset_mode="Disabled") makes one'
        )
    if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
        raise ValueError(
            f"autoreset_mode: {env.metadata.get('autoreset_mode')}, must be AutoresetMode.DISABLED"
        )


def step_copies(
    agent: Agent, env: gym.vector.VectorEnv[Any, Any, Any], budget: Budget, seed: int
) -> Iterator[Progress]:
    """Train an agent by its shared interface alone: act, observe, update."""
    observation, _ = env.reset(seed=seed)
    agent.reset(observation)
    done, taken, earned = 0, 0, 0.0
    while budget.allows(done, taken) and budget.fits(taken + env.num_envs):
        action = agent.act(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        agent.observe(action, reward, observation, terminated, truncated)
        ended = terminated | truncated
        done, taken = done + int(ended.sum()), taken + env.num_envs
        earned += float(np.sum(reward))
        metrics = agent.update()
        if metrics:
            yield Progress(done, taken, metrics, earned)
        if ended.any():
            observation, _ = env.reset(options={"reset_mask": ended})
            agent.reset(observation, ended)
    yield Progress(done, taken, agent.finish(), earned)
