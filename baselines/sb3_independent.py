"""One learner of Stable-Baselines3 for each agent of a team, all in the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO

from baselines.sb3 import SB3Learner, algorithm_keywords
from baselines.sb3_policy import network_actions
from baselines.sb3_vec_env import Array


class IndependentPPO(SB3Learner):
    """One PPO for each agent of a team; to each, the other agents are part of the environment.

    `PPO.learn` drives an environment alone, so that N of them cannot share its episodes. Here a
    loop in place of its `collect_rollouts` asks every agent's policy, steps the team once, and
    adds to each agent's own rollout buffer what that agent saw and did and the team's reward,
    bootstrapped at a truncation. All else is Stable-Baselines3's own, agent by agent: policy,
    advantages (`compute_returns_and_advantage`), and minibatches, losses and optimiser (`train`).
    With one agent the result is that of `PPO.learn`, weight by weight.

    Agent n's PPO is seeded by the seed plus n. Constructor and interface are `SB3Learner`'s.
    """

    def _build_models(self, discount: float, seed: int) -> list[Any]:
        models = []
        for n, space in enumerate(network_actions(self.settings, self._spaces[1])):
            model: Any = PPO(
                "MlpPolicy",
                None,  # type: ignore[arg-type]  # as `PPO.load` does it, spaces come next
                gamma=discount,
                seed=seed + n,
                _init_setup_model=False,
                **algorithm_keywords(self.settings),
            )
            model.observation_space, model.action_space = self._env.observation_space, space
            model.n_envs = self.settings.n_envs
            model._setup_model()
            models.append(model)
        self._env.seed(seed)
        self._rows = self._env.reset()
        self._begun = np.ones(self.settings.n_envs, dtype=np.bool_)
        return models

    def _roll_out(self) -> None:
        for model in self._models:
            model.policy.set_training_mode(False)
            model.rollout_buffer.reset()
        for _ in range(self.settings.rollout_steps // self.settings.n_envs):
            self._step()
        for n, model in enumerate(self._models):
            values = _values(model, self._rows[n :: len(self._models)])
            model.rollout_buffer.compute_returns_and_advantage(values, self._begun)
            model.train()
            model.logger.dump(self._env.steps)

    def _step(self) -> None:
        """Step the team once and add each agent's part to its rollout buffer."""
        size, seen = len(self._models), self._rows
        with torch.no_grad():
            chosen = [
                model.policy(torch.as_tensor(seen[n::size])) for n, model in enumerate(self._models)
            ]
        actions = np.stack([action.numpy() for action, _, _ in chosen], axis=1)
        rows, rewards, done, infos = self._env.step(actions)
        for n, (model, (_, values, log_prob)) in enumerate(zip(self._models, chosen, strict=True)):
            model.rollout_buffer.add(
                seen[n::size],
                actions[:, n, None],
                _bootstrapped(model, rewards[n::size], infos[n::size]),
                self._begun,
                values,
                log_prob,
            )
        self._rows, self._begun = np.asarray(rows), done[::size]


def _bootstrapped(model: Any, rewards: Array, infos: Sequence[dict[str, Any]]) -> Array:
    """Add to the last reward (n,) of truncated episodes the value of what would have followed."""
    rewards = rewards.copy()
    for copy, info in enumerate(infos):
        if info.get("TimeLimit.truncated", False):
            value = _values(model, info["terminal_observation"][None])
            rewards[copy] += float(model.gamma * value)
    return rewards


def _values(model: Any, rows: Array) -> torch.Tensor:
    """Return the critic's values (n, 1)."""
    with torch.no_grad():
        values: torch.Tensor = model.policy.predict_values(torch.as_tensor(rows))
    return values
