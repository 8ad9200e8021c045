"""Which environment, as data, and the one evaluation that every policy goes through."""

from __future__ import annotations

import contextlib
import difflib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorEnv

from bnprl_envs import registry
from bnprl_envs.model import TabularModel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
AnyVectorEnv = VectorEnv[Any, Any, Any]

FILE_HORIZON = 251
"""Steps of an episode in the environment of a model file, where not given."""
GYMNASIUM_DISCOUNT = 0.99
"""Discount of an environment that states none, where not given."""
COPIES = 1024
"""Largest number of copies that one evaluation steps together."""


class Policy(Protocol):
    """What an evaluation runs. A policy that draws does so from `predict_rng`, if it has one."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions for (n_envs,) observations; return them and the new state."""


@dataclass(frozen=True)
class EnvironmentSpec:
    """Which environment, as data that JSON can hold.

    Attributes:
        id: an id of this suite, an id of Gymnasium, or the path of a model file (any existing
            file; names that end in .pomdp, .POMDP or .dpomdp are always paths).
        kwargs: constructor keywords (`resetting=True`). `max_episode_steps` and `discount` can
            be given for every environment and replace its own.
    """

    id: str
    kwargs: dict[str, Any] = field(default_factory=dict)

    def make_vec(self, num_envs: int, autoreset_mode: str = "Disabled") -> AnyVectorEnv:
        """Make a batch of copies.

        Args:
            num_envs: number of copies.
            autoreset_mode: "Disabled", "SameStep" or "NextStep".

        Raises:
            ValueError: there is no such environment (near misses are named), it does not take
                the keywords, or it has several agents.
            OSError: the model file cannot be read.
        """
        entry = None if self._is_file() else self._entry()
        if entry is not None and entry.kind.startswith("parallel"):
            raise ValueError(
                f"{self.id} has several agents; training and comparing serve one agent so far"
            )
        model = self.model()
        if model is not None:
            from bnprl_envs.tabular_vector import TabularVectorEnv  # imports numba

            return TabularVectorEnv(
                model, num_envs, max_episode_steps=self.horizon, autoreset_mode=autoreset_mode
            )
        known = gym.spec(self.id).vector_entry_point if self.id.startswith("bnprl/") else None
        modes: dict[str, Any] = (
            {"autoreset_mode": autoreset_mode}
            if known is not None
            else {
                "vectorization_mode": "sync",
                "vector_kwargs": {"autoreset_mode": gym.vector.AutoresetMode(autoreset_mode)},
            }
        )
        keywords = {name: value for name, value in self.kwargs.items() if name != "discount"}
        try:
            return gym.make_vec(self.id, num_envs=num_envs, **modes, **keywords)
        except TypeError as error:
            raise ValueError(f"{self.id}: {error}") from error

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
            if entry is None or entry.kind != "tabular":
                return None
        elif not Path(self.id).is_file():
            raise ValueError(f"{self.id}: there is no such model file")
        try:
            stamp = os.stat(self.id).st_mtime_ns if self._is_file() else None
            return _model(self.id, stamp, discount, **arguments)
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
        return gym.spec(self.id).max_episode_steps if entry is None else entry.horizon

    @property
    def discount(self) -> float:
        """Factor of the returns, in (0, 1].

        Raises:
            ValueError: there is no such environment, or the factor is out of range.
            OSError: the model file cannot be read.
        """
        given = self.kwargs.get("discount")
        if given is None:
            model, entry = self.model(), None if self._is_file() else self._entry()
            if model is not None:
                return model.discount
            return GYMNASIUM_DISCOUNT if entry is None else entry.discount
        if not 0.0 < given <= 1.0:
            raise ValueError(f"discount: {given}, must lie in (0, 1]")
        return float(given)

    def _is_file(self) -> bool:
        return self.id.lower().endswith((".pomdp", ".dpomdp")) or Path(self.id).is_file()

    def _entry(self) -> registry.Entry | None:
        """Return the suite's entry, None for another environment of Gymnasium."""
        if self.id in registry.environment_ids():
            return registry.entry(self.id)
        if self.id in gym.registry:
            return None
        near = difflib.get_close_matches(self.id, gym.registry, n=3, cutoff=0.75)
        if near and not any(name.startswith("bnprl/") for name in near):
            raise ValueError(f"unknown environment {self.id!r}; did you mean {' or '.join(near)}?")
        return registry.entry(self.id)  # raises, and names near misses


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


@dataclass(frozen=True)
class Evaluation:
    """What a policy achieved in n episodes.

    Attributes:
        returns: (n,) discounted return of each episode.
        lengths: (n,) steps of each episode.
        exact: expected discounted return over an infinite horizon, computed from the model; None
            where there is no model or the policy is no controller.
    """

    returns: FloatArray
    lengths: IntArray
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
        ValueError: `episodes` is below 1, the policy was made for other spaces, or as
            `EnvironmentSpec.make_vec`.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes}, must be at least 1")
    rng = np.random.default_rng(seed)
    model, horizon = environment.model(), environment.horizon
    controllers = getattr(policy, "controllers", None)
    belief = getattr(policy, "policy", None)
    if model is not None and horizon is not None and belief is not None and not deterministic:
        return _simulate_belief(belief, model, horizon, episodes, rng)
    if model is None or horizon is None or controllers is None or deterministic:
        return _simulate(policy, environment, episodes, rng, deterministic)
    return _simulate_compiled(controllers, model, horizon, episodes, rng)


def _simulate_belief(
    policy: Any, model: TabularModel, horizon: int, episodes: int, rng: np.random.Generator
) -> Evaluation:
    from bnprl_agents.belief.rollout import belief_rollout  # imports numba

    batch = belief_rollout(model, policy, episodes=episodes, horizon=horizon, rng=rng)
    return Evaluation(batch.returns(model.discount), np.diff(batch.offsets))


def _simulate_compiled(
    controllers: Any, model: TabularModel, horizon: int, episodes: int, rng: np.random.Generator
) -> Evaluation:
    from bnprl_agents.controllers.scoring import simulated_returns  # imports numba
    from bnprl_agents.controllers.value import controller_value

    returns, lengths = simulated_returns(
        model,
        controllers,
        episodes=episodes,
        horizon=horizon,
        discount=model.discount,
        rng=rng,
    )
    exact = controller_value(model, controllers, model.discount) if model.discount < 1.0 else None
    return Evaluation(returns, lengths, exact)


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
    returns, lengths = np.zeros(episodes), np.zeros(episodes, dtype=np.int64)
    value, weight, elapsed = np.zeros(copies), np.ones(copies), np.zeros(copies, dtype=np.int64)
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
            weight *= discount
            elapsed += 1
            begun = terminated | truncated
            if begun.any():
                counted = begun & (row < end)
                returns[row[counted]], lengths[row[counted]] = value[counted], elapsed[counted]
                row[counted] += 1
                value[begun], weight[begun], elapsed[begun] = 0.0, 1.0, 0
                observation, _ = env.reset(options={"reset_mask": begun})
    return Evaluation(returns, lengths)


def _check_spaces(policy: Any, env: AnyVectorEnv) -> None:
    """Refuse a policy that says it was made for other spaces."""
    for name in ("observation_space", "action_space"):
        made_for, here = getattr(policy, name, None), getattr(env, f"single_{name}")
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
