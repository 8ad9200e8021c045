"""Which environment, as data: an id of this suite or registered elsewhere, or a model file."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import os
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import pettingzoo
from gymnasium.vector import VectorEnv

from baselines.own import import_module
from bnprl_envs import registry
from bnprl_envs.model import TabularModel

AnyVectorEnv = VectorEnv[Any, Any, Any]

FILE_HORIZON = 251
"""Steps of an episode in the environment of a model file, where not given."""
FOREIGN_DISCOUNT = 0.99
"""Discount of an environment that is registered elsewhere, where not given."""
TRIAL_STEPS = 100
"""Steps by random actions that find out whether a team from elsewhere can be served."""


@dataclass(frozen=True)
class EnvironmentSpec:
    """Which environment, as data that JSON can hold.

    Attributes:
        id: an id of this suite, of Gymnasium or of PettingZoo (parallel), or the path of a model
            file (any existing file; names that end in .pomdp, .POMDP or .dpomdp are always
            paths). "module:id" imports the module first, which registers the id.
        kwargs: constructor keywords (`resetting=True`). `max_episode_steps` and `discount` can
            be given for every environment and replace its own.

    Raises:
        ValueError: one of them is of another type, or the discount is out of range.
    """

    id: str
    kwargs: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.id, str):
            raise ValueError(f"environment {self.id!r}: must be a name")
        if not isinstance(self.kwargs, dict) or not all(
            isinstance(key, str) for key in self.kwargs
        ):
            raise ValueError(f"{self.id}: kwargs must be an object of keywords")
        given = self.kwargs.get("discount")
        if given is not None and not (isinstance(given, int | float) and 0.0 < given <= 1.0):
            raise ValueError(f"discount: {given!r}, must lie in (0, 1]")

    def make_vec(self, num_envs: int, autoreset_mode: str = "Disabled") -> AnyVectorEnv:
        """Make a batch of copies; of a team, arrays (num_envs, N) with `possible_agents`.

        Args:
            num_envs: number of copies.
            autoreset_mode: "Disabled", "SameStep" or "NextStep"; teams know the first only.

        Raises:
            ValueError: there is no such environment (near misses are named), it does not take
                the keywords, one from elsewhere cannot be made, or it is a team that cannot be
                served.
            OSError: the model file cannot be read.
        """
        try:
            if self.has_several_agents():
                if autoreset_mode != "Disabled":
                    raise ValueError(f"autoreset_mode: {autoreset_mode}, teams know Disabled only")
                return self._make_team(num_envs)
            return self._make_single(num_envs, autoreset_mode)
        except TypeError as error:
            raise ValueError(f"{self.id}: {error}") from error

    def try_out(self) -> None:
        """Make the environment once, so that what is wrong with it is said at once.

        Whether a team that is registered elsewhere keeps its agents and shares its reward shows
        only in an episode: one by random actions is begun.

        Raises:
            ValueError: as `make_vec`, or a team's agents come and go or earn different rewards.
            OSError: the model file cannot be read.
        """
        _ = self.horizon, self.discount
        env = self.make_vec(1)
        if self.has_several_agents() and not self._is_file() and self._entry() is None:
            env.action_space.seed(0)
            env.reset(seed=0)
            for _ in range(TRIAL_STEPS):
                _, _, terminated, truncated, _ = env.step(env.action_space.sample())
                if (terminated | truncated).any():
                    break
        env.close()

    def model(self) -> TabularModel | None:
        """Return the tables; None where the environment has none.

        Raises:
            ValueError: as `make_vec`.
            OSError: the model file cannot be read.
        """
        arguments = dict(self.kwargs)
        arguments.pop("max_episode_steps", None)
        discount = arguments.pop("discount", None)
        if not self._is_file():
            entry = self._entry()
            if entry is None or not entry.kind.endswith("tabular"):
                return None
        elif not Path(self.id).is_file():
            raise ValueError(f"{self.id}: there is no such model file")
        try:
            if self._is_file():
                return _model(self.id, os.stat(self.id).st_mtime_ns, discount, **arguments)
            return _model(self.name, None, discount, **arguments)
        except TypeError as error:
            raise ValueError(f"{self.id}: {error}") from error

    @property
    def horizon(self) -> int | None:
        """Steps before an episode is truncated; None: no limit.

        Raises:
            ValueError: there is no such environment.
        """
        given: int | None = self.kwargs.get("max_episode_steps")
        if given is not None:
            return given
        if self._is_file():
            return FILE_HORIZON
        entry = self._entry()
        if entry is not None:
            return entry.horizon
        if self.has_several_agents():
            limit: int | None = pettingzoo.spec("parallel", self.name).max_cycles
            return limit
        return gym.spec(self.name).max_episode_steps

    @property
    def discount(self) -> float:
        """Factor of the returns, in (0, 1].

        Raises:
            ValueError: there is no such environment.
            OSError: the model file cannot be read.
        """
        given = self.kwargs.get("discount")
        if given is None:
            model, entry = self.model(), None if self._is_file() else self._entry()
            if model is not None:
                return model.discount
            return FOREIGN_DISCOUNT if entry is None else entry.discount
        return float(given)

    def _make_single(self, num_envs: int, autoreset_mode: str) -> AnyVectorEnv:
        model = self.model()
        if model is not None:
            from bnprl_envs.tabular_vector import TabularVectorEnv  # imports numba

            return TabularVectorEnv(
                model, num_envs, max_episode_steps=self.horizon, autoreset_mode=autoreset_mode
            )
        known = gym.spec(self.name).vector_entry_point if self.id.startswith("bnprl/") else None
        modes: dict[str, Any] = (
            {"autoreset_mode": autoreset_mode}
            if known is not None
            else {
                "vectorization_mode": "sync",
                "vector_kwargs": {"autoreset_mode": gym.vector.AutoresetMode(autoreset_mode)},
            }
        )
        with contextlib.nullcontext() if known is not None else made_elsewhere(self.id):
            return gym.make_vec(self.name, num_envs=num_envs, **modes, **self._keywords())

    def _make_team(self, num_envs: int) -> AnyVectorEnv:
        model = self.model()
        if model is not None:
            from bnprl_envs.tabular_parallel import TabularParallelBatch

            return TabularParallelBatch(model, num_envs, max_episode_steps=self.horizon)
        entry = self._entry()
        if entry is not None and entry.vector_factory is not None:
            module, name = entry.vector_factory.split(":")
            make: Any = getattr(importlib.import_module(module), name)
            batch: AnyVectorEnv = make(num_envs, **self._keywords())
            return batch
        from bnprl_envs.parallel_batch import ParallelBatch

        keywords = self._keywords()
        cycles = keywords.pop("max_episode_steps", None)
        with made_elsewhere(self.id):
            copies = [
                pettingzoo.make("parallel", self.name, max_cycles=cycles, **keywords)
                for _ in range(num_envs)
            ]
        try:
            return ParallelBatch(copies.pop, num_envs)
        except ValueError as error:
            raise ValueError(f"{self.id}: {error}") from error

    def _keywords(self) -> dict[str, Any]:
        return {name: value for name, value in self.kwargs.items() if name != "discount"}

    def _is_file(self) -> bool:
        return self.id.lower().endswith((".pomdp", ".dpomdp")) or Path(self.id).is_file()

    def has_several_agents(self) -> bool:
        """Return whether it is a team's.

        Raises:
            ValueError: there is no such environment.
            OSError: the model file cannot be read.
        """
        if self._is_file():
            model = self.model()
            return model is not None and model.n_agents > 1
        entry = self._entry()
        if entry is None:
            return self.name in pettingzoo.parallel_registry
        return entry.kind.startswith("parallel")

    @property
    def name(self) -> str:
        """The id without the module before its colon, which is imported."""
        module, _, name = self.id.rpartition(":")
        if module:
            import_module(module, self.id)
        return name

    def _entry(self) -> registry.Entry | None:
        """Return the suite's entry, None for an environment that is registered elsewhere."""
        name = self.name
        if name in registry.environment_ids():
            return registry.entry(name)
        elsewhere = [*gym.registry, *pettingzoo.parallel_registry]
        if name in elsewhere:
            return None
        near = difflib.get_close_matches(name, elsewhere, n=3, cutoff=0.75)
        if near and not any(known.startswith("bnprl/") for known in near):
            raise ValueError(f"unknown environment {name!r}; did you mean {' or '.join(near)}?")
        return registry.entry(name)  # raises, and names near misses


@contextlib.contextmanager
def made_elsewhere(id: str) -> Iterator[None]:
    """Turn whatever somebody else's constructor raises into a ValueError of one line."""
    try:
        yield
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise ValueError(
            f"{id}: cannot be made: {type(error).__name__}: {error} "
            f"({where.filename}:{where.lineno})"
        ) from error


@lru_cache(maxsize=32)
def _model(
    source: str, modified: int | None, discount: float | None, **arguments: Any
) -> TabularModel:
    """Read or build a model; `modified` makes a changed file a new one."""
    if modified is None:
        model = registry.model(source, **arguments)
    elif arguments:
        raise TypeError(f"a model file takes no keyword {', '.join(sorted(arguments))}")
    else:
        from bnprl_envs.model_files import read_model

        model = read_model(source)
    return model if discount is None else model.replace(discount=discount)
