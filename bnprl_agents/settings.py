"""What the settings of all agents share: numbers are numbers, and tables have a largest size."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

KINDS: dict[type, tuple[Any, str]] = {
    bool: ((bool, np.bool_), "true or false"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
}
"""Type of a setting's default -> what its value must be, and how people call that."""

MOST_ENTRIES = 2**26
"""Of the largest table that settings may ask for, 512 MiB: a policy file may come from anybody."""


@dataclass(frozen=True)
class Settings:
    """Base of every agent's settings; a subclass checks the ranges after calling this.

    Values become plain Python ones of their default's type, which come back equal from a policy
    file: numpy's numbers become numbers, and lists tuples.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = _plain(field.name, getattr(self, field.name), type(field.default))
            object.__setattr__(self, field.name, value)


def _plain(name: str, value: Any, kind: type) -> Any:
    """A setting's value as a plain one of some type; of tuples, whose entries are numbers, too.

    Raises:
        ValueError: it is not of that kind, or not finite.
    """
    if kind is tuple:
        if np.ndim(value) == 0:
            raise ValueError(f"{name}: {value!r}, must be a tuple of numbers")
        return tuple(_plain(name, entry, float) for entry in value)
    if kind not in KINDS:
        return value.item() if isinstance(value, np.generic) else value
    allowed, words = KINDS[kind]
    if not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool):
        raise ValueError(f"{name}: {value!r}, must be {words}")
    if not math.isfinite(value):
        raise ValueError(f"{name}: {value!r}, must be finite")
    return kind(value)


def check_entries(name: str, *shape: int) -> None:
    """Check the size of a table before it is made.

    Args:
        name: of the setting, or the part, that the size comes from.
        shape: of the table.

    Raises:
        ValueError: it would have more than `MOST_ENTRIES` entries.
    """
    if math.prod(shape) > MOST_ENTRIES:
        raise ValueError(
            f"{name}: asks for a table of {' x '.join(map(str, shape))} entries, more than "
            f"{MOST_ENTRIES:,}"
        )
