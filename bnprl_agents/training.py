"""The one loop that runs any agent in any vector environment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from bnprl_agents.agent import Agent, Metrics
from bnprl_agents.compiled_values import CompiledValueAgent, Place, act_and_learn
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.controllers.rollout import check_fit
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.history_agent import HistoryAgent
from bnprl_agents.search.controller_search import ControllerSearch
from bnprl_agents.search.simulator import BudgetedSimulator, BudgetSpentError, simulator_of
from bnprl_envs.model import TabularModel
from bnprl_envs.worlds import world_of

REPORTS = 200
"""Reports of a compiled run whose budget is given in steps."""
NO_LIMIT = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Progress:
    """How far training has come.

    Attributes:
        episodes: episodes finished so far.
        steps: environment steps taken so far, over all copies.
        metrics: what the last update reported; {} between updates.
        reward: earned while learning, not discounted, over all steps; None where nobody counts.
    """

    episodes: int
    steps: int
    metrics: Metrics = field(default_factory=dict)
    reward: float | None = None


def train(
    agent: Agent,
    env: gym.vector.VectorEnv[Any, Any, Any],
    *,
    seed: int,
    episodes: int | None = None,
    steps: int | None = None,
) -> Iterator[Progress]:
    """Train an agent until the budget is spent; yields after every update.

    Where the environment is tabular and the agent learns controllers or belief policies, whole
    episodes are sampled by the compiled rollout instead of stepping copies. The two agree in law.
    A learner of action values that learns from every step, with one copy, in a world of
    `bnprl_envs.worlds`, is compiled with that world likewise. `ControllerSearch` gets a simulator
    of the environment (`simulator_of`), to which it hands its own seeds; what it has under way when
    the budget ends is lost.

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
    budget = episodes if steps is None else steps
    if (episodes is None) == (steps is None) or budget is None or budget < 1:
        raise ValueError(f"episodes: {episodes}, steps: {steps}; give one of them, at least 1")
    if isinstance(agent, ControllerSearch):
        return _train_by_search(agent, env, episodes, steps)
    if not hasattr(env, "num_envs"):
        raise ValueError(
            f"env: {type(env).__name__} is no batch; gym.make_vec(id, num_envs=1, "
            'autoreset_mode="Disabled") makes one'
        )
    if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
        raise ValueError(
            f"autoreset_mode: {env.metadata.get('autoreset_mode')}, must be AutoresetMode.DISABLED"
        )
    model, horizon = getattr(env, "model", None), getattr(env, "max_episode_steps", None)
    if isinstance(agent, HistoryAgent) and isinstance(model, TabularModel) and horizon:
        if isinstance(agent, ControllerAgent):
            check_fit(model, agent.controllers)
        agent.check_reward(smallest_reward(model))
        return _train_compiled(agent, model, horizon, seed, episodes, steps)
    if isinstance(agent, ControllerAgent) and agent.discount == 1.0 and not _has_horizon(env):
        raise ValueError(
            "discount: 1, but the environment has no horizon, so that returns may have no bound; "
            "give it max_episode_steps, or the agent a discount below 1"
        )
    world = world_of(env)
    if isinstance(agent, CompiledValueAgent) and agent.compiles and world and env.num_envs == 1:
        return _train_values(agent, world, horizon or NO_LIMIT, seed, episodes, steps)
    return _train_stepwise(agent, env, seed, episodes, steps)


def _has_horizon(env: Any) -> bool:
    spec = getattr(env, "spec", None)
    limits = [getattr(env, "max_episode_steps", None), getattr(spec, "max_episode_steps", None)]
    return any(limit is not None for limit in limits)


def smallest_reward(model: TabularModel) -> float:
    """The smallest reward of any transition with any observation that is possible then."""
    action, _, end = model.support
    reward = model.support_reward
    if reward.shape[1] > 1:
        reward = reward[model.observation_rows[action * model.n_states + end].nonzero()]
    return float(reward.min())


def _train_by_search(
    agent: ControllerSearch, env: Any, episodes: int | None, steps: int | None
) -> Iterator[Progress]:
    simulator = simulator_of(env, agent.discount)
    limit = steps if steps is not None else (episodes or 0) * simulator.horizon
    budgeted = BudgetedSimulator(simulator, limit)
    try:
        while True:
            metrics = agent.improve(budgeted, limit - simulator.steps)
            yield Progress(simulator.episodes, simulator.steps, metrics)
    except BudgetSpentError:
        yield Progress(simulator.episodes, simulator.steps)


def _train_compiled(
    agent: HistoryAgent,
    model: TabularModel,
    horizon: int,
    seed: int,
    episodes: int | None,
    steps: int | None,
) -> Iterator[Progress]:
    rng = np.random.default_rng(seed)
    done, taken, earned = 0, 0, 0.0
    while (episodes is not None and done < episodes) or (steps is not None and taken < steps):
        wanted = agent.batch_episodes
        batch = agent.sample(
            model,
            episodes=wanted if episodes is None else min(wanted, episodes - done),
            horizon=horizon,
            rng=rng,
        )
        spent = steps is not None and taken + batch.n_steps > steps
        if steps is not None and spent:
            batch = batch.first(_fitting(batch, steps - taken))
        if batch.n_episodes:
            done, taken = done + batch.n_episodes, taken + batch.n_steps
            earned += float(batch.rewards.sum())
            yield Progress(done, taken, agent.learn(batch), earned)
        if spent:
            break
    if not done:
        yield Progress(0, 0, reward=0.0)


def _fitting(batch: EpisodeBatch, steps: int) -> int:
    """How many of the first episodes have no more than so many steps together."""
    return int(np.searchsorted(batch.offsets, steps, side="right")) - 1


def _train_stepwise(
    agent: Agent,
    env: gym.vector.VectorEnv[Any, Any, Any],
    seed: int,
    episodes: int | None,
    steps: int | None,
) -> Iterator[Progress]:
    observation, _ = env.reset(seed=seed)
    agent.reset(observation)
    done, taken, earned = 0, 0, 0.0
    while (episodes is None or done < episodes) and (
        steps is None or taken + env.num_envs <= steps
    ):
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


def _train_values(
    agent: CompiledValueAgent,
    world: tuple[Any, ...],
    horizon: int,
    seed: int,
    episodes: int | None,
    steps: int | None,
) -> Iterator[Progress]:
    rng = np.random.default_rng(seed)
    features = agent.features
    place = Place(features.points, features.offset, features.range)
    state, elapsed = np.zeros(features.offset.size), np.zeros(1, dtype=np.int64)
    done, taken = 0, 0
    while (episodes is not None and done < episodes) or (steps is not None and taken < steps):
        slice_steps = NO_LIMIT
        if steps is not None:
            slice_steps = min(max(1, steps // REPORTS), steps - taken)
        exponent = agent.config.exploration_exponent if agent.explores else -1.0
        new_steps, new_episodes, error = act_and_learn(
            agent.learner,
            world,
            place,
            exponent,
            horizon,
            state,
            elapsed,
            agent.steps,
            slice_steps,
            1 if steps is None else NO_LIMIT,
            agent.rng,
            rng,
        )
        agent.steps += new_steps
        done, taken = done + new_episodes, taken + new_steps
        yield Progress(done, taken, agent.report(error))
