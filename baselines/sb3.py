"""Stable-Baselines3's learners behind the interface of every contender.

Only the modules `baselines.sb3*`, settings and checks aside, import Stable-Baselines3 and torch,
which takes seconds: `baselines.contenders` names them by string and imports them when such a
learner is built.

Stable-Baselines3 draws from the global generators of numpy, torch and Python while it learns.
Predictions in between draw from a generator of their own, so that a learning curve depends on
the seed alone; but two of these learners must not take turns in one process.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from stable_baselines3.common.utils import LinearSchedule, safe_mean

from baselines.environment import EnvironmentSpec
from baselines.sb3_checks import check_served
from baselines.sb3_policy import (
    ALGORITHMS,
    SB3Policy,
    build_encoder,
    load_sb3_policy,
    policy_keywords,
    save_sb3_policy,
)
from baselines.sb3_settings import DQNSettings, OnPolicySettings, PPOSettings, SB3Settings
from baselines.sb3_vec_env import SB3VecEnv
from bnprl_agents.training import Progress
from bnprl_envs.team import agent_spaces

__all__ = ["SB3Learner", "SB3Policy", "load_sb3_policy"]


class SB3Learner:
    """One of Stable-Baselines3's algorithms, learning in slices of a rollout.

    In a team one network serves all agents: to the algorithm each agent is a copy of its own.

    Args:
        environment: what to learn in; `settings.n_envs` copies are made.
        settings: which algorithm, and how.
        seed: of everything random.
        tensorboard: folder for the algorithm's own log; None: no log.

    Raises:
        ValueError: the algorithm cannot serve the environment.
    """

    policy_suffix = ".npz"

    def __init__(
        self,
        environment: EnvironmentSpec,
        settings: SB3Settings,
        seed: int,
        tensorboard: Path | None = None,
    ) -> None:
        torch.set_num_threads(1)  # two only slow networks of this size
        env = environment.make_vec(settings.n_envs, "Disabled")
        try:
            check_served(settings, env)
        except ValueError as error:
            raise ValueError(f"{environment.id}: {error}") from error
        self.settings = settings
        self._spaces = agent_spaces(env)
        encoder = build_encoder(settings, self._spaces[0])
        scaled = isinstance(settings, OnPolicySettings) and settings.scale_rewards
        self._env = SB3VecEnv(env, encoder, environment.discount if scaled else None)
        first, second = np.random.SeedSequence(seed).generate_state(2)
        self._models = self._build_models(environment.discount, int(first))
        self._latest = [_Latest() for _ in self._models]
        for index, (model, latest) in enumerate(zip(self._models, self._latest, strict=True)):
            outputs: list[KVWriter] = [latest]
            if tensorboard is not None:
                folder = tensorboard / f"agent_{index}" if len(self._models) > 1 else tensorboard
                outputs.append(TensorBoardOutputFormat(str(folder)))
            model.set_logger(Logger(None, outputs))
        networks = [model.policy for model in self._models]
        self._policy = SB3Policy(networks, encoder, *self._spaces, int(second))
        self._used = False

    @property
    def policy(self) -> SB3Policy:
        """The current policy."""
        return self._policy

    def learn(self, *, episodes: int | None = None, steps: int | None = None) -> Iterator[Progress]:
        """Learn until the budget is spent; yields after every rollout.

        Args:
            episodes: budget of finished episodes; learning stops at the first rollout's end at
                or past it.
            steps: budget of environment steps over all copies; a rollout that would pass it is
                not begun. Give one of the two.

        Raises:
            ValueError: the budget is not given by exactly one positive number, or is smaller
                than one rollout.
            RuntimeError: called a second time.
        """
        budget = episodes if steps is None else steps
        if (episodes is None) == (steps is None) or budget is None or budget < 1:
            raise ValueError(f"episodes: {episodes}, steps: {steps}; give one of them, at least 1")
        if steps is not None and steps < self.settings.rollout_steps:
            raise ValueError(
                f"steps: {steps}, must be at least one rollout of {self.settings.rollout_steps}"
            )
        if self._used:
            raise RuntimeError("learn() can be called once")
        self._used = True
        return self._slices(episodes, steps)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy (not the learner) to a file that `load_sb3_policy` reads."""
        save_sb3_policy(path, self._policy, self.settings)

    def _slices(self, episodes: int | None, steps: int | None) -> Iterator[Progress]:
        env, size = self._env, self.settings.rollout_steps

        def share_left(_: float = 0.0) -> float:
            spent = env.episodes / episodes if episodes else env.steps / (steps or 1)
            return max(0.0, 1.0 - spent)

        if isinstance(self.settings, DQNSettings):  # its own schedule would see each slice only
            epsilon = LinearSchedule(
                1.0, self.settings.exploration_final, self.settings.exploration_fraction
            )
            self._models[0].exploration_schedule = lambda _: epsilon(share_left())
        try:
            while share_left() > 0.0 and (steps is None or env.steps + size <= steps):
                self._roll_out()
                yield Progress(env.episodes, env.steps, self._metrics(), env.reward)
        finally:
            for model in self._models:
                model.logger.close()
            env.close()

    def _build_models(self, discount: float, seed: int) -> list[Any]:
        """Return the algorithms at work, one for each network."""
        algorithm, policy_name = ALGORITHMS[type(self.settings)]
        constructor: Any = algorithm
        keywords = algorithm_keywords(self.settings)
        return [constructor(policy_name, self._env, gamma=discount, seed=seed, **keywords)]

    def _roll_out(self) -> None:
        """Learn from one more rollout."""
        rows = self.settings.rollout_steps * self._env.encoder.rows
        self._models[0].learn(rows, reset_num_timesteps=False)

    def _metrics(self) -> dict[str, float]:
        """Return what the algorithms logged last, in their names, returns undiscounted."""
        logged: dict[str, list[float]] = {}
        for model, latest in zip(self._models, self._latest, strict=True):
            for name, value in (latest.values | model.logger.name_to_value).items():
                if name.startswith(("rollout/", "train/")):
                    logged.setdefault(name, []).append(float(value))
        if self._env.recent:
            returns, lengths = zip(*self._env.recent, strict=True)
            logged["rollout/ep_rew_mean"] = list(returns)
            logged["rollout/ep_len_mean"] = list(lengths)
        return {name: safe_mean(np.array(values)) for name, values in sorted(logged.items())}


class _Latest(KVWriter):
    """Keeps what was logged last, because the logger forgets it."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        self.values |= key_values

    def close(self) -> None:
        pass


def algorithm_keywords(settings: SB3Settings) -> dict[str, Any]:
    """Return what the algorithm's constructor takes, by its own names."""
    common = {"policy_kwargs": policy_keywords(settings), "device": "cpu"}
    if isinstance(settings, DQNSettings):
        return common | {
            "learning_rate": settings.learning_rate,
            "buffer_size": settings.buffer_size,
            "batch_size": settings.batch_size,
            "learning_starts": settings.learning_starts,
            "train_freq": settings.train_freq,
            "gradient_steps": settings.gradient_steps,
            "target_update_interval": settings.target_update,
        }
    keywords = common | {
        "learning_rate": settings.learning_rate,
        "n_steps": settings.n_steps,
        "gae_lambda": settings.gae_lambda,
        "ent_coef": settings.entropy,
    }
    if isinstance(settings, PPOSettings):
        keywords |= {
            "batch_size": settings.batch_size,
            "n_epochs": settings.n_epochs,
            "clip_range": settings.clip_range,
        }
    return keywords
