"""What stands behind an entry of the table: lookup, models, registration."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NoReturn, cast

import gymnasium as gym
import pettingzoo

from bnprl_envs.model import TabularModel
from bnprl_envs.references import Reference
from bnprl_envs.rendering.scene import Scene

Kind = Literal["tabular", "class", "parallel-tabular", "parallel-class"]
"""What a factory returns: a `TabularModel` (seen through `TabularEnv` and `TabularVectorEnv`, or
if parallel through `TabularParallelEnv`), or an environment itself (a class). Parallel ones are
PettingZoo's, the others Gymnasium's."""


@dataclass(frozen=True)
class Entry:
    """One environment of the suite.

    Attributes:
        id: the id that `gymnasium.make` or `pettingzoo.make` knows.
        summary: one line for listings.
        factory: "module:function" that builds it; imported when first used. What it looks like
            is said by "module:function_scene", if there is one, with the same arguments.
        horizon: steps before an episode is truncated.
        discount: factor of the values, in (0, 1].
        references: values of the form that is registered.
        kind: what the factory returns.
        vector_factory: of the native batch, where the factory is an environment itself.
    """

    id: str
    summary: str
    factory: str
    horizon: int
    discount: float
    references: tuple[Reference, ...] = ()
    kind: Kind = "tabular"
    vector_factory: str | None = None


def find(table: Mapping[str, Entry], id: str) -> Entry:
    """Return the entry of an id.

    Raises:
        ValueError: there is no such id; the message names near misses.
    """
    if id in table:
        return table[id]
    near = _near_misses(table, id)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(table)}"
    raise ValueError(f"unknown environment {id!r}; {hint}")


def build(row: Entry, arguments: Mapping[str, Any]) -> TabularModel:
    """Return the model of an entry; equal calls may return the same object.

    Raises:
        ValueError: the entry has no tables, or an argument is out of range.
        TypeError: the benchmark does not take such an argument.
    """
    if row.kind not in ("tabular", "parallel-tabular"):
        raise ValueError(f"{row.id} has no tables: it is simulated by {row.factory}")
    if all(isinstance(value, Hashable) for value in arguments.values()):
        return _cached(row.factory, **arguments)
    return _built(row.factory, **arguments)


def scene(row: Entry, arguments: Mapping[str, Any]) -> Scene | None:
    """Return how the states of an entry's model look: what `module:name_scene` says, if anything.

    Raises:
        ValueError: an argument is out of range.
        TypeError: the benchmark does not take such an argument.
    """
    module, name = row.factory.split(":")
    function = getattr(importlib.import_module(module), f"{name}_scene", None)
    return None if function is None else cast(Scene, function(**arguments))


def register(row: Entry) -> None:
    """Register an entry with Gymnasium or PettingZoo; an id already there is left alone."""
    if row.kind.startswith("parallel"):
        _register_parallel(row)
        return
    if row.id in gym.registry:
        return
    if row.kind == "tabular":
        gym.register(
            row.id,
            entry_point="bnprl_envs.tabular:TabularEnv",
            vector_entry_point="bnprl_envs.tabular_vector:TabularVectorEnv",
            max_episode_steps=row.horizon,
            kwargs={"model": row.id},
        )
    else:
        gym.register(
            row.id,
            entry_point=row.factory,
            vector_entry_point=row.vector_factory,
            max_episode_steps=row.horizon,
        )


def _register_parallel(row: Entry) -> None:
    if row.id not in gym.registry:
        refusal = "bnprl_envs.registration:refuse_team"
        gym.register(row.id, entry_point=refusal, kwargs={"team": row.id})
    if row.id in pettingzoo.parallel_registry:
        return
    tabular = row.kind == "parallel-tabular"
    pettingzoo.register(
        "parallel",
        row.id,
        "bnprl_envs.tabular_parallel:TabularParallelEnv" if tabular else row.factory,
        max_cycles=row.horizon,
        kwargs={"model": row.id} if tabular else {},
    )


def refuse_team(team: str, **_: Any) -> NoReturn:
    """Tell who asks Gymnasium for a team where it is to be had.

    Raises:
        gymnasium.error.UnregisteredEnv: always.
    """
    raise gym.error.UnregisteredEnv(
        f"{team} is a team, a PettingZoo parallel environment: "
        f'pettingzoo.make("parallel", "{team}") makes it'
    )


def _built(factory: str, **arguments: Any) -> TabularModel:
    module, name = factory.split(":")
    function = cast(Callable[..., TabularModel], getattr(importlib.import_module(module), name))
    return function(**arguments)


_cached = lru_cache(maxsize=32, typed=True)(_built)


def _near_misses(ids: Iterable[str], id: str) -> list[str]:
    """Return the ids close to a misspelt one, with or without namespace and version."""
    names: dict[str, str] = {}
    for known in ids:
        name = known.lower()
        bare = name.split("/")[-1]
        names |= dict.fromkeys((name, bare, bare.rsplit("-v", 1)[0]), known)
    close = difflib.get_close_matches(id.lower(), names, n=3, cutoff=0.6)
    return list(dict.fromkeys(names[name] for name in close))
