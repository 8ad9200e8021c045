"""What the settings of all agents share: numbers are numbers, and tables have a largest size."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from numbers import Integral, Real

KINDS = {int: (Integral, "a whole number"), float: (Real, "a number")}
"""Type of a setting's default -> what its value must be, and how people call that."""

MOST_ENTRIES = 2**26
"""Of the largest table that settings may ask for, 512 MiB: a policy file may come from anybody."""


@dataclass(frozen=True)
class Settings:
    """Base of every agent's settings; a subclass checks the ranges after calling this."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            kind, words = KINDS.get(type(field.default), (object, ""))
            if words and (isinstance(value, bool) or not isinstance(value, kind)):
                raise ValueError(f"{field.name}: {value!r}, must be {words}")


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
