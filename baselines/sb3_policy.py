"""Policies of Stable-Baselines3's learners, and how they are kept in files.

A policy file holds the weights as plain arrays and one JSON text, because Stable-Baselines3's
own archives cannot be read without executing what is in them. Imported by `baselines.sb3` only.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import torch
from gymnasium.spaces.utils import flatdim
from sb3_contrib import RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy

from baselines.sb3_settings import (
    A2CSettings,
    DQNSettings,
    IndependentPPOSettings,
    PPOSettings,
    RecurrentPPOSettings,
    SB3Settings,
    SharedPPOSettings,
    SharedRecurrentPPOSettings,
)
from baselines.sb3_vec_env import Encoder
from bnprl_agents.policy_files import (
    build_space,
    describe_space,
    read_policy,
    refusing_damage,
    write_policy,
)
from bnprl_envs.team import joint_space

Array = npt.NDArray[Any]

FORMAT = "bnprl-sb3-policy"
"""How a policy file calls itself."""

ALGORITHMS: dict[type[Any], tuple[type[BaseAlgorithm], str]] = {
    A2CSettings: (A2C, "MlpPolicy"),
    PPOSettings: (PPO, "MlpPolicy"),
    SharedPPOSettings: (PPO, "MlpPolicy"),
    IndependentPPOSettings: (PPO, "MlpPolicy"),
    RecurrentPPOSettings: (RecurrentPPO, "MlpLstmPolicy"),
    SharedRecurrentPPOSettings: (RecurrentPPO, "MlpLstmPolicy"),
    DQNSettings: (DQN, "MlpPolicy"),
}
"""Settings -> the algorithm and the name of its policy class."""


class SB3Policy:
    """A learned policy that takes the environment's own observations and does the encoding.

    Args:
        networks: one; in a team one for all agents or one each.
        encoder: of the environment's observations.
        observation_space: of the environment; of a team, a dict by agent.
        action_space: likewise.
        seed: of the draws that `predict` makes.

    Attributes:
        predict_rng: source of every draw of `predict`.
    """

    def __init__(
        self,
        networks: Sequence[BasePolicy],
        encoder: Encoder,
        observation_space: Any,
        action_space: Any,
        seed: int = 0,
    ) -> None:
        self.networks = tuple(networks)
        self.observation_space = observation_space
        self.action_space = action_space
        self.predict_rng = np.random.default_rng(seed)
        self._encoder = encoder
        self._team = isinstance(action_space, Mapping)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions; the signature is Stable-Baselines3's.

        Args:
            observation: (n_envs,) observations of the environment, or a scalar; of a team a dict
                of these by agent, or (n_envs, N).
            state: what the last call returned (frame stack and LSTM states); None at the start.
            episode_start: (n_envs,) booleans: where true the state is begun anew.
            deterministic: take the most probable action instead of sampling. A Q-network's
                policy is greedy in both cases.

        Returns:
            The actions, in the form of the observations, and the new state.
        """
        shape, agents = self._encoder.shape, tuple(self.action_space) if self._team else ()
        seen = np.asarray(observation)
        if isinstance(observation, Mapping):
            seen = np.stack([np.asarray(observation[agent]) for agent in agents], axis=-1)
        scalar = seen.shape == shape
        seen = seen.reshape(-1, *shape)
        begun = np.zeros(len(seen), dtype=np.bool_)
        if state is None:
            begun[:] = True
        elif episode_start is not None:
            begun |= np.asarray(episode_start, dtype=np.bool_)
        stack, memories = (None, (None,) * len(self.networks)) if state is None else state
        stack = self._encoder.encode(seen, stack, begun)
        actions, memories = self._chosen(stack, memories, begun, deterministic)
        if self._team:
            actions = actions.reshape(len(seen), -1)
        chosen = actions[0] if scalar else actions
        if isinstance(observation, Mapping):
            chosen = dict(zip(agents, chosen.T, strict=True))
        return chosen, (stack, memories)

    def _chosen(
        self, rows: Array, memories: Any, begun: Array, deterministic: bool
    ) -> tuple[Array, Any]:
        """Ask network m of M about the rows m, m + M, ...; return all actions and memories."""
        m_all = len(self.networks)
        starts = np.repeat(begun, self._encoder.rows)
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(int(self.predict_rng.integers(2**63)))
            found = [
                network.predict(rows[m::m_all], memories[m], starts[m::m_all], deterministic)
                for m, network in enumerate(self.networks)
            ]
        actions = np.stack([action for action, _ in found], axis=1).reshape(
            len(rows), *found[0][0].shape[1:]
        )
        return actions, tuple(memory for _, memory in found)


def save_sb3_policy(path: str | os.PathLike[str], policy: SB3Policy, settings: SB3Settings) -> None:
    """Write a policy's weights as plain arrays; the file appears by atomic rename."""
    meta = {
        "format": FORMAT,
        "version": 1,
        "settings_type": type(settings).__name__,
        "settings": dataclasses.asdict(settings),
        "observation_space": describe_space(policy.observation_space),
        "action_space": describe_space(policy.action_space),
    }
    arrays = {
        f"weights/{m}/{name}": weight.numpy()
        for m, network in enumerate(policy.networks)
        for name, weight in network.state_dict().items()
    }
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
    kind = {kind.__name__: kind for kind in ALGORITHMS}[meta["settings_type"]]
    settings = kind(**meta["settings"])
    observation_space = build_space(meta["observation_space"])
    action_space = build_space(meta["action_space"])
    n_weights = sum(array.size for array in arrays.values())
    _check_size(settings, observation_space, action_space, n_weights)
    encoder = build_encoder(settings, observation_space)
    algorithm, policy_name = ALGORITHMS[kind]
    networks = []
    for m, space in enumerate(network_actions(settings, action_space)):
        network = algorithm.policy_aliases[policy_name](
            encoder.space, space, lambda _: 0.0, **policy_keywords(settings)
        )
        prefix = f"weights/{m}/"
        weights = {
            name.removeprefix(prefix): torch.as_tensor(array, dtype=torch.float32)
            for name, array in arrays.items()
            if name.startswith(prefix)
        }
        network.load_state_dict(weights)
        networks.append(network)
    return SB3Policy(networks, encoder, observation_space, action_space)


def build_encoder(settings: SB3Settings, observation_space: Any) -> Encoder:
    """Return the encoder of an environment's observations; the space of a team is a dict."""
    if isinstance(observation_space, Mapping):
        observation_space = joint_space(observation_space.values())
    return Encoder(observation_space, settings.frame_stack, indexed=settings.team == "shared")


def network_actions(settings: SB3Settings, action_space: Any) -> list[gym.Space[Any]]:
    """Return the action space of each network; the space of a team is a dict by agent."""
    spaces = list(action_space.values()) if isinstance(action_space, Mapping) else [action_space]
    return spaces if settings.team == "independent" else spaces[:1]


def _check_size(
    settings: SB3Settings, observation_space: Any, action_space: Any, n_weights: int
) -> None:
    """Refuse to build networks larger than the weights that are to fill them."""
    team = isinstance(observation_space, Mapping)
    parts = list(observation_space.values()) if team else [observation_space]
    inputs = max(map(flatdim, parts))
    if isinstance(parts[0], gym.spaces.Discrete):
        inputs = inputs * settings.frame_stack + len(parts) * (settings.team == "shared")
    outputs = max(map(flatdim, network_actions(settings, action_space)))
    units = settings.hidden_units
    first = getattr(settings, "lstm_units", units)
    if inputs * first + max(units, first) ** 2 + units * outputs > n_weights:
        raise ValueError(
            f"{n_weights} weights are too few for {inputs} inputs, {max(units, first)} units and "
            f"{outputs} outputs"
        )


def policy_keywords(settings: SB3Settings) -> dict[str, Any]:
    """Return what the constructor of the policy takes, by its own names."""
    keywords: dict[str, Any] = {"net_arch": [settings.hidden_units] * 2}
    if isinstance(settings, RecurrentPPOSettings):
        keywords["lstm_hidden_size"] = settings.lstm_units
    return keywords
