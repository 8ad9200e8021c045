"""Words and numbers of a model file, line by line, and the error that says where it is wrong."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable

import numpy as np

from bnprl_envs.tables import FloatArray

MAX_SHOWN = 40
"""Longest stretch of a file, in characters, that a message repeats."""


class ModelFileError(ValueError):
    """A model file that cannot be read; its text is the one line `FILE:LINE: reason`.

    Attributes:
        path: the file.
        line: the line, from 1.
        reason: what is wrong there.
    """

    def __init__(self, path: str | os.PathLike[str], line: int, reason: str) -> None:
        self.path = os.fspath(path)
        self.line = line
        self.reason = reason
        super().__init__(self.path, line, reason)

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.reason}"


class Tokens:
    """The words of a file in order; a colon is a word, a `#` begins a comment.

    Args:
        path: named in errors.
        lines: the lines of the file; one at a time is held.

    Attributes:
        line: number of the line of the word that `peek` shows or `take` last returned, from 1.
    """

    def __init__(self, path: str | os.PathLike[str], lines: Iterable[str]) -> None:
        self.line = 1
        self._path = path
        self._lines = enumerate(lines, start=1)
        self._words: list[str] = []
        self._next = 0

    def error(self, reason: str, line: int | None = None) -> ModelFileError:
        """Return the error of a line, by default of the current one."""
        return ModelFileError(self._path, self.line if line is None else line, reason)

    def peek(self) -> str:
        """Return the next word without taking it, "" at the end of the file."""
        if self._next == len(self._words) and not self._advance():
            return ""
        return self._words[self._next]

    def take(self) -> str:
        """Return the next word.

        Raises:
            ModelFileError: the file has ended.
        """
        if self._next == len(self._words) and not self._advance():
            raise self.error("the file ends in the middle of a statement")
        self._next += 1
        return self._words[self._next - 1]

    def more_on_line(self) -> bool:
        """Whether the line of the last word has another one."""
        return self._next < len(self._words)

    def take_colon(self) -> None:
        """Take a colon.

        Raises:
            ModelFileError: another word stands there.
        """
        word = self.take()
        if word != ":":
            raise self.error(f"expected a colon, found {shown(word)}")

    def take_number(self) -> float:
        """Take one finite number.

        Raises:
            ModelFileError: another word stands there.
        """
        word = self.take()
        try:
            return number(word)
        except ValueError as error:
            raise self.error(str(error)) from None

    def take_numbers(self, count: int) -> FloatArray:
        """Take `count` finite numbers, over as many lines as they fill; returns (count,).

        Raises:
            ModelFileError: another word stands there, or the file ends.
        """
        numbers = np.empty(count)
        done = 0
        while done < count:
            if not self.peek():
                raise self.error(f"the file ends after {done} of {count} numbers")
            words = self._words[self._next : self._next + count - done]
            try:
                numbers[done : done + len(words)] = as_numbers(words)
            except ValueError as error:
                raise self.error(f"{error}, among {count} numbers") from None
            done += len(words)
            self._next += len(words)
        return numbers

    def _advance(self) -> bool:
        try:
            for line, text in self._lines:
                self.line = line
                if "\0" in text:
                    raise self.error("not a text file")
                self._words = text.partition("#")[0].replace(":", " : ").split()
                self._next = 0
                if self._words:
                    return True
        except UnicodeDecodeError:
            raise self.error("not a text file in UTF-8", self.line + 1) from None
        self._words, self._next = [], 0
        return False


def number(word: str) -> float:
    """Return a finite number.

    Raises:
        ValueError: the word is not one.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in word or not word.isascii():
        raise ValueError(f"expected a finite number, found {shown(word)}")
    return value


def as_numbers(words: list[str]) -> FloatArray:
    """Return finite numbers as an array, one for each word.

    Raises:
        ValueError: names the first word that is not one.
    """
    joined = "".join(words)
    try:
        values = np.array(list(map(float, words)))
    except ValueError:
        values = np.array([math.nan])
    if "_" in joined or not joined.isascii() or not np.isfinite(values).all():
        values = np.array(list(map(number, words)))
    return values


def shown(word: str) -> str:
    """Return a word of a file as a message repeats it: quoted, and cut where long."""
    return repr(word if len(word) <= MAX_SHOWN else word[: MAX_SHOWN - 3] + "...")
