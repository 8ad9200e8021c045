"""What the settings of all agents share: numbers are numbers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from numbers import Integral, Real

KINDS = {int: (Integral, "a whole number"), float: (Real, "a number")}
"""Type of a setting's default -> what its value must be, and how people call that."""


@dataclass(frozen=True)
class Settings:
    """Base of every agent's settings; a subclass checks the ranges after calling this."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            kind, words = KINDS.get(type(field.default), (object, ""))
            if words and (isinstance(value, bool) or not isinstance(value, kind)):
                raise ValueError(f"{field.name}: {value!r}, must be {words}")
