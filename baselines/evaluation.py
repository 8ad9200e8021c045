"""The one evaluation that every policy goes through."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from baselines.environment import AnyVectorEnv, EnvironmentSpec
from bnprl_agents.belief.learner import BeliefAgent
from bnprl_agents.belief.policy import BeliefPolicy
from bnprl_agents.belief.rollout import belief_rollout
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.controllers.scoring import simulated_scores
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.value_learner import ValueAgent
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import policy_value
from bnprl_envs.tables import FloatArray
from bnprl_envs.team import agent_spaces

IntArray = npt.NDArray[np.int64]

COPIES = 1024
"""Largest number of copies that one evaluation steps together."""
LONGEST = 100_000
"""Steps after which an episode is taken to be endless."""


class Policy(Protocol):
    """What an evaluation runs. A policy that draws does so from `predict_rng`, if it has one."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions for (n_envs,) observations, of a team (n_envs, N); also the new state."""


@dataclass(frozen=True)
class Evaluation:
    """What a policy achieved in n episodes.

    Attributes:
        returns: (n,) discounted return of each episode.
        lengths: (n,) steps of each episode.
        rewards: (n,) sum of each episode's rewards, not discounted.
        exact: expected discounted return over an infinite horizon, computed from the model; None
            where there is no model, or the policy is neither a controller nor greedy by values of
            states that it sees.
    """

    returns: FloatArray
    lengths: IntArray
    rewards: FloatArray
    exact: float | None = None


def evaluate(
    policy: Policy,
    environment: EnvironmentSpec,
    *,
    episodes: int,
    seed: int | np.random.SeedSequence,
    deterministic: bool = False,
) -> Evaluation:
    """Run a policy for a fixed number of episodes, each counted whatever its length.

    Copies run in parallel and how many episodes each contributes is fixed in advance: the first
    n episodes that finish would favour short ones. Controllers on a tabular model are sampled by
    the compiled rollout and get their exact value too.

    Args:
        policy: controllers and Stable-Baselines3's policies alike; it is left unchanged, its
            random generator included.
        environment: where to run it.
        episodes: n, at least 1.
        seed: of the environment's and the policy's draws.
        deterministic: the most probable action instead of a sample. Off for every contender
            unless stated: the most probable actions of a controller are another policy.

    Raises:
        ValueError: `episodes` is below 1, the policy was made for other spaces, an episode does
            not end within `LONGEST` steps, or as `EnvironmentSpec.make_vec`.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes}, must be at least 1")
    rng = np.random.default_rng(seed)
    model, horizon = environment.model(), environment.horizon
    if model is not None and horizon is not None and not deterministic:
        if isinstance(policy, BeliefAgent):
            return _simulate_belief(policy.policy, model, horizon, episodes, rng)
        if isinstance(policy, ControllerAgent):
            return _simulate_compiled(policy.controllers, model, horizon, episodes, rng)
    found = _simulate(policy, environment, episodes, rng, deterministic)
    return replace(found, exact=_greedy_value(policy, model, deterministic))


def _simulate_belief(
    policy: BeliefPolicy, model: TabularModel, horizon: int, episodes: int, rng: np.random.Generator
) -> Evaluation:
    batch = belief_rollout(model, policy, episodes=episodes, horizon=horizon, rng=rng)
    return Evaluation(batch.returns(model.discount), batch.lengths, batch.returns(1.0))


def _simulate_compiled(
    controllers: tuple[Controller, ...],
    model: TabularModel,
    horizon: int,
    episodes: int,
    rng: np.random.Generator,
) -> Evaluation:
    found = simulated_scores(
        model,
        controllers,
        episodes=episodes,
        horizon=horizon,
        discount=model.discount,
        rng=rng,
    )
    exact = controller_value(model, controllers, model.discount) if model.discount < 1.0 else None
    return Evaluation(found.returns, found.lengths, found.rewards, exact)


def _greedy_value(policy: Policy, model: TabularModel | None, deterministic: bool) -> float | None:
    """Return the exact value of a policy that is greedy by the values of states."""
    if model is None or not model.fully_observed or model.discount == 1.0:
        return None
    if deterministic or not isinstance(policy, ValueAgent):
        return None
    return policy_value(model, policy.greedy_policy(np.arange(model.n_states)))


def _simulate(
    policy: Policy,
    environment: EnvironmentSpec,
    episodes: int,
    rng: np.random.Generator,
    deterministic: bool,
) -> Evaluation:
    copies, discount = min(episodes, COPIES), environment.discount
    quota = np.full(copies, episodes // copies)
    quota[: episodes % copies] += 1
    row = np.cumsum(quota) - quota  # where each copy writes its next episode
    end = row + quota
    returns, rewards = np.zeros(episodes), np.zeros(episodes)
    lengths, elapsed = np.zeros(episodes, dtype=np.int64), np.zeros(copies, dtype=np.int64)
    value, total, weight = np.zeros(copies), np.zeros(copies), np.ones(copies)
    state, begun = None, np.ones(copies, dtype=np.bool_)
    with (
        contextlib.closing(environment.make_vec(copies)) as env,
        _drawing_from(policy, rng.spawn(1)[0]),
    ):
        _check_spaces(policy, env)
        observation, _ = env.reset(seed=int(rng.integers(2**31)))
        while (row < end).any():
            action, state = policy.predict(observation, state, begun, deterministic)
            observation, reward, terminated, truncated, _ = env.step(action)
            value += weight * reward
            total += reward
            weight *= discount
            elapsed += 1
            begun = terminated | truncated
            if elapsed.max() >= LONGEST and not begun[elapsed.argmax()]:
                raise ValueError(
                    f"{environment.id}: an episode of {LONGEST:,} steps has not ended; give the "
                    "environment max_episode_steps, as gymnasium.register does"
                )
            if begun.any():
                counted = begun & (row < end)
                ends = row[counted]
                returns[ends], rewards[ends] = value[counted], total[counted]
                lengths[ends] = elapsed[counted]
                row[counted] += 1
                value[begun], total[begun], weight[begun], elapsed[begun] = 0.0, 0.0, 1.0, 0
                observation, _ = env.reset(options={"reset_mask": begun})
    return Evaluation(returns, lengths, rewards)


def _check_spaces(policy: Any, env: AnyVectorEnv) -> None:
    """Refuse a policy that says it was made for other spaces."""
    for name, here in zip(("observation_space", "action_space"), agent_spaces(env), strict=True):
        made_for = getattr(policy, name, None)
        if made_for is not None and made_for != here:
            raise ValueError(f"the policy's {name} is {made_for}, the environment's is {here}")


@contextlib.contextmanager
def _drawing_from(policy: Any, rng: np.random.Generator) -> Iterator[None]:
    """Let a policy draw from `rng` for a while, so that its own generator does not move."""
    own = getattr(policy, "predict_rng", None)
    if own is not None:
        policy.predict_rng = rng
    try:
        yield
    finally:
        if own is not None:
            policy.predict_rng = own
