"""The interface that every agent shares, and how agents are kept in files.

A policy file is one `.npz` archive: plain arrays and one JSON text (class, settings, spaces,
counters, random generator). Nothing in it is executed and no pickle is ever read.
"""

from __future__ import annotations

import abc
import dataclasses
import importlib
import io
import json
import math
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]
Metrics = dict[str, float]

AGENT_CLASSES = {
    "RandomAgent": "bnprl_agents.random_agent",
    "BatchEM": "bnprl_agents.controllers.em",
    "OnlineEM": "bnprl_agents.controllers.online_em",
}
"""Class name in a policy file -> the module that defines it; nothing else is ever imported."""

FILE_LIMIT = 2**31
"""Largest size in bytes of an unpacked policy file."""


class PolicyFileError(ValueError):
    """A file that does not hold a policy; the message is one line, `FILE: reason`."""


class Agent(abc.ABC):
    """A learner with the shared interface: reset, act, observe, update, predict, save.

    Observations, actions and rewards carry a leading axis of environments (n_envs,); a scalar
    is a batch of one and comes back as a scalar. For many agents observations and actions are
    dicts from agent name to such values, as in PettingZoo's parallel environments.

    Args:
        observation_space: space of one environment's observation, or a dict of them for many
            agents.
        action_space: likewise.
        config: settings, an instance of `Config`; None means the defaults.
        discount: factor in (0, 1].
        seed: everything random in the agent is drawn from two generators spawned from it, one
            for learning and one for `predict`, so that evaluation never disturbs learning.

    Raises:
        ValueError: a space, setting or discount that the agent cannot use.
    """

    Config: ClassVar[type[Any]]

    def __init__(
        self,
        observation_space: gym.Space[Any] | Mapping[str, gym.Space[Any]],
        action_space: gym.Space[Any] | Mapping[str, gym.Space[Any]],
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        if not 0.0 < discount <= 1.0:
            raise ValueError(f"discount: {discount}, must lie in (0, 1]")
        if config is not None and not isinstance(config, self.Config):
            raise ValueError(
                f"config: {type(config).__name__}, must be {self.Config.__name__} or None"
            )
        self.observation_space = observation_space
        self.action_space = action_space
        self.config = self.Config() if config is None else config
        self.discount = float(discount)
        learning, acting = np.random.SeedSequence(seed).spawn(2)
        self.rng = np.random.default_rng(learning)
        self.predict_rng = np.random.default_rng(acting)

    @abc.abstractmethod
    def reset(self, observation: Any, mask: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes with these first observations (only where `mask` is true)."""

    @abc.abstractmethod
    def act(self, observation: Any) -> Any:
        """Choose actions by the behaviour policy, which explores."""

    @abc.abstractmethod
    def observe(
        self, action: Any, reward: Any, observation: Any, terminated: Any, truncated: Any
    ) -> None:
        """Record one transition; `observation` is the true next one, also at an episode's end."""

    @abc.abstractmethod
    def update(self) -> Metrics:
        """Learn from what was observed since the last update; {} if there is nothing to do."""

    @abc.abstractmethod
    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions by the learned policy, without exploration or learning.

        The signature is Stable-Baselines3's, so that its `evaluate_policy` runs unchanged.

        Args:
            observation: (n_envs,) observations, or a scalar.
            state: what the last call returned; None at the start.
            episode_start: (n_envs,) booleans: where true the state is begun anew.
            deterministic: take the most probable action instead of sampling. For a stochastic
                controller that is another policy than the one its exact value scores.

        Returns:
            The actions and the new state.
        """

    @abc.abstractmethod
    def state_arrays(self) -> Arrays:
        """Everything learned, as arrays."""

    @abc.abstractmethod
    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over what `state_arrays` and `counters` gave.

        Raises:
            ValueError: an array is missing or has the wrong shape.
        """

    def counters(self) -> dict[str, Any]:
        """Everything else that resuming needs, as JSON values."""
        return {}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the agent to a policy file, which appears by atomic rename."""
        meta = {
            "format": "bnprl-policy",
            "version": 1,
            "agent": type(self).__name__,
            "config": dataclasses.asdict(self.config),
            "discount": self.discount,
            "observation_space": _describe_space(self.observation_space),
            "action_space": _describe_space(self.action_space),
            "counters": self.counters(),
            "rng": self.rng.bit_generator.state,
            "predict_rng": self.predict_rng.bit_generator.state,
        }
        text = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
        target = Path(path)
        partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, meta=text, **self.state_arrays())
        partial.replace(target)


def load(path: str | os.PathLike[str]) -> Agent:
    """Read an agent from a policy file; it goes on exactly where the saved one stood.

    Raises:
        PolicyFileError: the file does not hold a policy, or holds more than `FILE_LIMIT` bytes.
        OSError: the file cannot be read.
    """
    data = Path(path).read_bytes()
    try:
        arrays = _read_archive(data)
        meta = json.loads(arrays.pop("meta").tobytes())
        if meta["format"] != "bnprl-policy" or meta["version"] != 1:
            raise ValueError(f"format {meta['format']!r}, version {meta['version']!r}")
        if meta["agent"] not in AGENT_CLASSES:
            raise ValueError(f"unknown agent {meta['agent']!r}")
        cls = getattr(importlib.import_module(AGENT_CLASSES[meta["agent"]]), meta["agent"])
        agent: Agent = cls(
            _build_space(meta["observation_space"]),
            _build_space(meta["action_space"]),
            cls.Config(**meta["config"]),
            discount=meta["discount"],
            seed=0,
        )
        agent.restore(arrays, meta["counters"])
        agent.rng.bit_generator.state = meta["rng"]
        agent.predict_rng.bit_generator.state = meta["predict_rng"]
    except (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise PolicyFileError(f"{path}: not a bnprl policy file ({error})") from error
    return agent


def _read_archive(data: bytes) -> Arrays:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(info.file_size for info in archive.infolist())
        if size > FILE_LIMIT:
            raise ValueError(f"unpacks to {size:,} bytes, more than {FILE_LIMIT:,}")
        for info in archive.infolist():
            with archive.open(info) as member:
                _check_header(info, member)
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _check_header(info: zipfile.ZipInfo, member: Any) -> None:
    """Refuse an array whose header promises more than its member holds."""
    version = np.lib.format.read_magic(member)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in read:
        raise ValueError(f"array format {version} in {info.filename!r}")
    shape, _, dtype = read[version](member)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > info.file_size:
        raise ValueError(f"array {info.filename!r} of shape {shape}, {dtype} is not plain data")


def _describe_space(space: Any) -> Any:
    if isinstance(space, Mapping) and not isinstance(space, gym.Space):
        return {"agents": {name: _describe_space(part) for name, part in space.items()}}
    if isinstance(space, gym.spaces.Discrete):
        return {"type": "Discrete", "n": int(space.n), "start": int(space.start)}
    if isinstance(space, gym.spaces.Box):
        return {
            "type": "Box",
            "low": space.low.tolist(),
            "high": space.high.tolist(),
            "dtype": str(space.dtype),
        }
    raise ValueError(f"space {space} cannot be saved: Discrete and Box can")


def _build_space(text: Any) -> Any:
    if "agents" in text:
        return {name: _build_space(part) for name, part in text["agents"].items()}
    if text["type"] == "Discrete":
        return gym.spaces.Discrete(text["n"], start=text["start"])
    if text["type"] == "Box":
        dtype = np.dtype(text["dtype"])
        low, high = np.array(text["low"], dtype=dtype), np.array(text["high"], dtype=dtype)
        return gym.spaces.Box(low, high, dtype=dtype.type)
    raise ValueError(f"unknown space {text['type']!r}")
