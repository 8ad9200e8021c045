"""Policies of Stable-Baselines3's learners, and how they are kept in files.

A policy file holds the weights as plain arrays and one JSON text, because Stable-Baselines3's
own archives cannot be read without executing what is in them. Imported by `baselines.sb3` only.
"""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy

from baselines.sb3_settings import (
    A2CSettings,
    DQNSettings,
    PPOSettings,
    RecurrentPPOSettings,
    SB3Settings,
)
from baselines.sb3_vec_env import Encoder
from bnprl_agents.policy_files import (
    build_space,
    describe_space,
    read_policy,
    refusing_damage,
    write_policy,
)

Array = npt.NDArray[Any]

FORMAT = "bnprl-sb3-policy"
"""How a policy file calls itself."""

ALGORITHMS: dict[type[Any], tuple[type[BaseAlgorithm], str]] = {
    A2CSettings: (A2C, "MlpPolicy"),
    PPOSettings: (PPO, "MlpPolicy"),
    RecurrentPPOSettings: (RecurrentPPO, "MlpLstmPolicy"),
    DQNSettings: (DQN, "MlpPolicy"),
}
"""Settings -> the algorithm and the name of its policy class."""


class SB3Policy:
    """A learned policy that takes the environment's own observations and does the encoding.

    Args:
        policy: the networks.
        encoder: of the environment's observations.
        observation_space: of the environment.
        action_space: of the environment.
        seed: of the draws that `predict` makes.

    Attributes:
        predict_rng: source of every draw of `predict`.
    """

    def __init__(
        self,
        policy: BasePolicy,
        encoder: Encoder,
        observation_space: gym.Space[Any],
        action_space: gym.Space[Any],
        seed: int = 0,
    ) -> None:
        self.networks = policy
        self.observation_space = observation_space
        self.action_space = action_space
        self.predict_rng = np.random.default_rng(seed)
        self._encoder = encoder

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions; the signature is Stable-Baselines3's.

        Args:
            observation: (n_envs,) observations of the environment, or a scalar.
            state: what the last call returned (frame stack and LSTM state); None at the start.
            episode_start: (n_envs,) booleans: where true the state is begun anew.
            deterministic: take the most probable action instead of sampling. A Q-network's
                policy is greedy in both cases.

        Returns:
            The actions and the new state.
        """
        shape = self._encoder.shape
        seen = np.asarray(observation)
        scalar = seen.shape == shape
        seen = seen.reshape(-1, *shape)
        begun = np.zeros(len(seen), dtype=np.bool_)
        if state is None:
            begun[:] = True
        elif episode_start is not None:
            begun |= np.asarray(episode_start, dtype=np.bool_)
        stack, memory = (None, None) if state is None else state
        stack = self._encoder.encode(seen, stack, begun)
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(int(self.predict_rng.integers(2**63)))
            action, memory = self.networks.predict(stack, memory, begun, deterministic)
        return action[0] if scalar else action, (stack, memory)


def save_sb3_policy(
    path: str | os.PathLike[str],
    networks: BasePolicy,
    settings: SB3Settings,
    observation_space: gym.Space[Any],
    action_space: gym.Space[Any],
) -> None:
    """Write a policy's weights as plain arrays; the file appears by atomic rename."""
    algorithm, _ = ALGORITHMS[type(settings)]
    meta = {
        "format": FORMAT,
        "version": 1,
        "algorithm": algorithm.__name__,
        "settings": dataclasses.asdict(settings),
        "observation_space": describe_space(observation_space),
        "action_space": describe_space(action_space),
    }
    arrays = {f"weights/{name}": w.numpy() for name, w in networks.state_dict().items()}
    write_policy(path, meta, arrays)


def load_sb3_policy(path: str | os.PathLike[str]) -> SB3Policy:
    """Read a policy that `SB3Learner.save` wrote; no pickle is read.

    Raises:
        PolicyFileError: the file does not hold such a policy.
        OSError: the file cannot be read.
    """
    torch.set_num_threads(1)
    meta, arrays = read_policy(path)
    with refusing_damage(path):
        return _rebuilt(meta, arrays)


def _rebuilt(meta: Any, arrays: dict[str, Array]) -> SB3Policy:
    """Build a policy's networks from its settings and fill in the weights."""
    if meta["format"] != FORMAT or meta["version"] != 1:
        raise ValueError(f"format {meta['format']!r}, version {meta['version']!r}")
    named = {cls.__name__: (kind, cls, name) for kind, (cls, name) in ALGORITHMS.items()}
    kind, algorithm, policy_name = named[meta["algorithm"]]
    settings = kind(**meta["settings"])
    observation_space = build_space(meta["observation_space"])
    action_space = build_space(meta["action_space"])
    _check_size(settings, observation_space, sum(array.size for array in arrays.values()))
    encoder = Encoder(observation_space, settings.frame_stack)
    networks = algorithm.policy_aliases[policy_name](
        encoder.space,
        action_space,
        lambda _: 0.0,
        **policy_keywords(settings),
    )
    weights = {
        name.removeprefix("weights/"): torch.as_tensor(array, dtype=torch.float32)
        for name, array in arrays.items()
    }
    networks.load_state_dict(weights)
    return SB3Policy(networks, encoder, observation_space, action_space)


def _check_size(settings: SB3Settings, space: gym.Space[Any], n_weights: int) -> None:
    """Refuse to build networks much larger than the weights that are to fill them."""
    inputs = int(space.n) * settings.frame_stack if isinstance(space, gym.spaces.Discrete) else 0
    widest = max(settings.hidden_units, getattr(settings, "lstm_units", 0))
    if inputs > n_weights or widest**2 > n_weights:
        raise ValueError(f"{n_weights} weights are too few for {inputs} inputs, {widest} units")


def policy_keywords(settings: SB3Settings) -> dict[str, Any]:
    """Return what the constructor of the policy takes, by its own names."""
    keywords: dict[str, Any] = {"net_arch": [settings.hidden_units] * 2}
    if isinstance(settings, RecurrentPPOSettings):
        keywords["lstm_hidden_size"] = settings.lstm_units
    return keywords
