"""What comes from the copies of an environment that an agent acts in."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from bnprl_agents.episodes import BoolArray, IntArray


def require_alive(alive: BoolArray) -> None:
    """Check that an episode is under way in every copy (n,).

    Raises:
        RuntimeError: one has ended, or none has begun.
    """
    if not alive.size or not alive.all():
        raise RuntimeError(
            "an episode has ended or none has begun: call reset(observation, mask) first"
        )


def check_copies(copies: int, **parts: npt.NDArray[Any]) -> None:
    """Check that each part of a transition has one value for every copy.

    Raises:
        ValueError: names the part, its shape and the one wanted.
    """
    for name, part in parts.items():
        if part.shape != (copies,):
            raise ValueError(f"{name}: shape {part.shape}, must be one for each copy, ({copies},)")


def integers(name: str, value: Any) -> IntArray:
    """Return whole numbers; floating-point ones pass where nothing is lost.

    Raises:
        ValueError: names the first that is none.
    """
    values = np.asarray(value)
    if values.dtype.kind in "iub":
        return values.astype(np.int64)
    if values.dtype.kind != "f":
        raise ValueError(f"{name}: {values.flat[0]!r} of type {values.dtype}, must be an integer")
    broken = ~np.isfinite(values) | (values != np.trunc(values))
    if broken.any():
        raise ValueError(f"{name}: {values[broken][0]}, must be an integer")
    return values.astype(np.int64)
