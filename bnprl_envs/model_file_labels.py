"""States, actions and observations of a model file, found by name or by index."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches

from bnprl_envs.model_file_tokens import number, shown

MAX_SIZE = 2**20
"""Largest number of states, of joint actions and of joint observations that a file may declare."""

SHAPES = ("uniform", "identity", "reset")
"""Words that stand for a row or a matrix."""

MAX_SEARCHED = 20_000
"""Names among which a message looks for near misses."""


@dataclass(frozen=True)
class Labels:
    """The states, or one agent's actions or observations: names, found by name or by index."""

    kind: str
    names: tuple[str, ...]
    _index: dict[str, int] = field(repr=False)

    @classmethod
    def parse(cls, kind: str, words: Sequence[str]) -> Labels:
        """Return the labels of a count or of a list of names.

        Raises:
            ValueError: no word, a count below 1 or above `MAX_SIZE`, a bad or repeated name.
        """
        if not words:
            raise ValueError(f"{kind}: a count or names are missing")
        if len(words) == 1 and (is_numeric(words[0]) or words[0].isdecimal()):
            names = tuple(map(str, range(parse_count(kind, words[0]))))
        else:
            names = tuple(words)
        if len(names) > MAX_SIZE:
            raise ValueError(f"{kind}: {len(names):,}, the limit is {MAX_SIZE:,}")
        index = {name: k for k, name in enumerate(names)}
        if len(index) < len(names):
            twice = next(name for k, name in enumerate(names) if index[name] != k)
            raise ValueError(f"{kind}: {shown(twice)} is named twice")
        for word in ("*", *SHAPES):
            if word in index:
                raise ValueError(f"{kind}: {word!r} cannot be a name")
        return cls(kind, names, index)

    def find(self, word: str) -> int:
        """Return the index of a name or of an index written in digits.

        Raises:
            ValueError: there is no such name; tells near misses.
        """
        place = self._index.get(word)
        if place is None:
            place = int(word) if word.isdecimal() and len(word) < 10 else len(self.names)
        if place < len(self.names):
            return place
        if is_numeric(word):
            raise ValueError(
                f"unknown {self.kind} {shown(word)}, must lie in 0..{len(self.names) - 1}"
            )
        raise ValueError(f"unknown {self.kind} {shown(word)}{near_misses(word, self.names)}")

    def find_all(self, words: Sequence[str]) -> list[int]:
        """Return the indices of several words; `*` stands for all."""
        everything = range(len(self.names)) if "*" in words else ()
        return [*everything, *(self.find(word) for word in words if word != "*")]


def near_misses(word: str, names: Sequence[str]) -> str:
    """Return `; did you mean ...?` with up to three names like the word, or ""."""
    close = get_close_matches(word, names[:MAX_SEARCHED], n=3) if len(word) < 80 else []
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""


def parse_count(kind: str, word: str) -> int:
    """Return a count.

    Raises:
        ValueError: not a whole number in 1..`MAX_SIZE`.
    """
    if not word.isdecimal() or int(word[:12]) < 1:
        raise ValueError(f"{kind}: count {shown(word)} must be a whole number above 0")
    if len(word) > 12 or int(word) > MAX_SIZE:
        raise ValueError(f"{kind}: count {shown(word)} is above the limit of {MAX_SIZE:,}")
    return int(word)


def is_numeric(word: str) -> bool:
    """Whether a word is a finite number."""
    try:
        number(word)
    except ValueError:
        return False
    return True
