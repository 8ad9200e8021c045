"""The one table of environments: id, factory, horizon, discount, reference values.

A new benchmark is one file in `bnprl_envs.benchmarks` and one entry here.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, cast

import gymnasium as gym

from bnprl_envs.model import TabularModel

Kind = Literal["tabular", "class"]
"""What a factory returns: a `TabularModel` (seen through `TabularEnv` and `TabularVectorEnv`), or
an environment itself (a Gymnasium class)."""


@dataclass(frozen=True)
class Reference:
    """A published or computed discounted value to hold a learner against.

    Attributes:
        name: what has this value: "random", "memoryless" (best memoryless policy), "lower" and
            "upper" (bounds of the optimum; "lower" is the best known policy), "dissertation".
        value: expected discounted return from the start distribution.
        source: where the number comes from.
    """

    name: str
    value: float
    source: str


@dataclass(frozen=True)
class Entry:
    """One environment of the suite.

    Attributes:
        id: the id that `gymnasium.make` knows.
        summary: one line for listings.
        factory: "module:function" that builds it; imported when first used.
        horizon: steps before an episode is truncated.
        discount: factor of the values, in (0, 1].
        references: values of the form that is registered.
        kind: what the factory returns.
    """

    id: str
    summary: str
    factory: str
    horizon: int
    discount: float
    references: tuple[Reference, ...] = ()
    kind: Kind = "tabular"


_EXACT = "exact: computed from the model"
_SEARCH = "computed: search over memoryless policies of the model"
_BOUNDS = "computed: point-based bounds of the model"
_DISSERTATION = "source dissertation: online EM, 50,000 episodes"

_ENTRIES = (
    Entry(
        id="bnprl/Hallway-v0",
        summary="robot with noisy wall sensors looks for one room of an office corridor",
        factory="bnprl_envs.benchmarks.hallway:hallway",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", 0.042233, _EXACT),
            Reference("memoryless", 0.3756, _SEARCH),
            Reference("lower", 0.514, _BOUNDS),
            Reference("upper", 0.558, _BOUNDS),
            Reference("dissertation", 0.3, _DISSERTATION),
        ),
    ),
    Entry(
        id="bnprl/Tag-v0",
        summary="robot hunts an opponent that it sees only when they share a cell",
        factory="bnprl_envs.benchmarks.tag:tag",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", -53.760587, _EXACT),
            Reference("memoryless", -15.1, _SEARCH),
            Reference("lower", -6.20, _BOUNDS),
            Reference("dissertation", -8.0, _DISSERTATION),
        ),
    ),
)

_TABLE = {row.id: row for row in _ENTRIES}


def environment_ids() -> tuple[str, ...]:
    """Return every registered id, in the order of the table."""
    return tuple(_TABLE)


def entry(id: str) -> Entry:
    """Return the entry of an id.

    Raises:
        ValueError: there is no such id; the message names near misses.
    """
    if id in _TABLE:
        return _TABLE[id]
    near = _near_misses(id)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(_TABLE)}"
    raise ValueError(f"unknown environment {id!r}; {hint}")


def model(id: str, **arguments: Any) -> TabularModel:
    """Return the model behind an id.

    Models are immutable, so equal calls may return the same object.

    Args:
        id: for example "bnprl/Hallway-v0".
        **arguments: of the benchmark's function, for example `resetting=True`.

    Raises:
        ValueError: the id is unknown (near misses are named), or has no tables.
        TypeError: the benchmark does not take such an argument.
    """
    row = entry(id)
    if row.kind != "tabular":
        raise ValueError(f"{id} has no tables: it is simulated by {row.factory}")
    return _build(row.factory, **arguments)


def register_environments() -> None:
    """Register every entry with Gymnasium; ids that are already there are left alone."""
    for row in _ENTRIES:
        if row.id in gym.registry:
            continue
        if row.kind == "tabular":
            gym.register(
                row.id,
                entry_point="bnprl_envs.tabular:TabularEnv",
                vector_entry_point="bnprl_envs.tabular_vector:TabularVectorEnv",
                max_episode_steps=row.horizon,
                kwargs={"model": row.id},
            )
        else:
            gym.register(row.id, entry_point=row.factory, max_episode_steps=row.horizon)


@lru_cache(maxsize=32)
def _build(factory: str, **arguments: Any) -> TabularModel:
    module, name = factory.split(":")
    function = cast(Callable[..., TabularModel], getattr(importlib.import_module(module), name))
    return function(**arguments)


def _near_misses(id: str) -> list[str]:
    """Return the ids close to a misspelt one, with or without namespace and version."""
    names: dict[str, str] = {}
    for known in _TABLE:
        name = known.lower()
        bare = name.split("/")[-1]
        names |= dict.fromkeys((name, bare, bare.rsplit("-v", 1)[0]), known)
    close = difflib.get_close_matches(id.lower(), names, n=3, cutoff=0.6)
    return list(dict.fromkeys(names[name] for name in close))
