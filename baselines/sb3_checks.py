"""Which environments Stable-Baselines3's learners can serve, decided without importing them."""

from __future__ import annotations

from typing import Any

from gymnasium.spaces import Box, Discrete

from baselines.environment import AnyVectorEnv
from baselines.sb3_settings import DQNSettings, SB3Settings


def check_served(settings: SB3Settings, env: AnyVectorEnv) -> None:
    """Refuse an environment that the learner of these settings cannot serve.

    Raises:
        ValueError: says why, and which learners could.
    """
    team = hasattr(env, "possible_agents")
    if team and settings.team is None:
        raise ValueError(
            "it has several agents; ppo-shared, ppo-independent and recurrent-ppo-shared serve them"
        )
    if not team and settings.team is not None:
        raise ValueError("it has one agent; ppo, a2c, dqn and recurrent-ppo serve it")
    if team:
        _check_team(settings, env.single_action_space)
    else:
        _check_single(settings, env.single_observation_space, env.single_action_space)


def _check_team(settings: SB3Settings, action: Any) -> None:
    if action.start.any():
        raise ValueError(f"action space {action}, every agent's must begin at 0")
    sizes = sorted(set(action.nvec.tolist()))
    if settings.team == "shared" and len(sizes) > 1:
        raise ValueError(
            f"agents have {' or '.join(map(str, sizes))} actions, but would share one network; "
            "ppo-independent serves them"
        )


def _check_single(settings: SB3Settings, observation: Any, action: Any) -> None:
    if not isinstance(observation, Discrete | Box):
        raise ValueError(f"observation space {observation}, must be Discrete or Box")
    continuous = isinstance(action, Box) and not isinstance(settings, DQNSettings)
    if not continuous and not (isinstance(action, Discrete) and action.start == 0):
        allowed = "Discrete from 0" + ("" if isinstance(settings, DQNSettings) else " or Box")
        raise ValueError(f"action space {action}, must be {allowed}")
