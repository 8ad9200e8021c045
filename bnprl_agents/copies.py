"""The copies of an environment that an agent acts in."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from bnprl_agents.episodes import BoolArray


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
