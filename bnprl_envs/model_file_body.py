"""The body of a model file: its `T:`, `O:` and `R:` statements.

Two grammars share it. Cassandra's ends lines where it likes and tells `T: a : s : s' p` from
`T: a : s <row>` by the number of colons; MADP's names one action an agent, has a colon before a
single number, and begins rows and matrices on a new line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bnprl_envs.model_file_labels import SHAPES, Labels, near_misses
from bnprl_envs.model_file_preamble import KEYWORDS, Header, Item, take_item
from bnprl_envs.model_file_specifications import Specifications
from bnprl_envs.model_file_tokens import ModelFileError, Tokens, number, shown
from bnprl_envs.tables import SUM_TOLERANCE

Place = tuple[int | None, ...]


@dataclass
class Slot:
    """A place between colons: the labels it may hold, one set an agent for joint slots."""

    kind: str
    labels: tuple[Labels, ...]
    _known: dict[str, Place] = field(default_factory=dict)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of labels of each agent."""
        return tuple(len(labels.names) for labels in self.labels)

    @property
    def size(self) -> int:
        """Number of joint labels."""
        return math.prod(self.sizes)

    def find(self, text: str) -> Place:
        """Return one index an agent, None for `*`.

        Raises:
            ValueError: a word is unknown, or their number is wrong.
        """
        place = self._known.get(text)
        if place is None:
            place = self._known[text] = self._find(text.split())
        return place

    def _find(self, words: Sequence[str]) -> Place:
        if words == ["*"]:
            return (None,) * len(self.labels)
        if len(words) == len(self.labels):
            pairs = zip(self.labels, words, strict=True)
            return tuple(None if word == "*" else labels.find(word) for labels, word in pairs)
        wanted = f"one word for each of {len(self.labels)} agents, '*' or a joint index"
        if len(self.labels) == 1:
            wanted = "one word, then a colon"
        elif len(words) == 1 and words[0].isdecimal():
            if len(words[0]) < 10 and int(words[0]) < self.size:
                return tuple(map(int, np.unravel_index(int(words[0]), self.sizes)))
            wanted = f"a joint index in 0..{self.size - 1}"
        raise ValueError(f"{self.kind} {shown(' '.join(words))}: must be {wanted}")


@dataclass(frozen=True)
class Table:
    """One of T, O and R: its slots in order, and what the file says about it."""

    keyword: str
    slots: tuple[Slot, ...]
    specifications: Specifications


def make_tables(tokens: Tokens, header: Header) -> dict[str, Table]:
    """Return the empty tables of a header; a fully observed model has no observation slots."""
    action = Slot("action", header.actions)
    states = (Slot("state", (header.states,)), Slot("state", (header.states,)))
    slots: dict[str, tuple[Slot, ...]] = {"T": (action, *states), "R": (action, *states)}
    if header.observations is not None:
        observation = Slot("observation", header.observations)
        slots["O"] = (action, states[1], observation)
        slots["R"] += (observation,)
    tables = {}
    for keyword, places in slots.items():
        sizes = [size for slot in places for size in slot.sizes]
        tables[keyword] = Table(keyword, places, Specifications(sizes, tokens.error))
    return tables


def read_body(
    tokens: Tokens, header: Header, following: tuple[str, int]
) -> tuple[dict[str, Table], list[Item]]:
    """Read statements up to the end of the file.

    Args:
        tokens: the file, behind the first statement's colon.
        header: the preamble.
        following: the first statement's keyword and line; "" where there is none.

    Returns:
        The tables by keyword, and the `E:` items.

    Raises:
        ModelFileError: a statement is malformed.
    """
    tables = make_tables(tokens, header)
    terminal: list[Item] = []
    keyword, line = following
    while keyword:
        if keyword in tables:
            _read_statement(tokens, header, tables[keyword], line)
            keyword, line = _next_keyword(tokens)
        elif keyword == "E":
            item, (keyword, line) = take_item(tokens, "E", line)
            terminal.append(item)
        elif keyword == "O":
            raise tokens.error("'O:' needs an 'observations:' line in the preamble", line)
        else:
            raise tokens.error(f"'{keyword}:' must come before the first T, O or R", line)
    return tables, terminal


def _next_keyword(tokens: Tokens) -> tuple[str, int]:
    """Take the next keyword and its colon; "" at the end of the file."""
    if not tokens.peek():
        return "", tokens.line
    word = tokens.take()
    line = tokens.line
    if word == "start" and tokens.peek() in ("include", "exclude"):
        tokens.take()
    if word not in KEYWORDS:
        try:
            number(word)
        except ValueError:
            hint = near_misses(word, KEYWORDS)
            raise tokens.error(f"expected T, O or R, found {shown(word)}{hint}") from None
        raise tokens.error(f"too many numbers: {shown(word)} follows a complete statement")
    tokens.take_colon()
    return word, line


def _read_statement(tokens: Tokens, header: Header, table: Table, line: int) -> None:
    """Read a T, O or R statement behind its first colon."""
    slots = table.slots
    head = _take_joint_head if header.multi_agent else _take_head
    try:
        prefix, depth = head(tokens, slots)
    except ModelFileError:
        raise
    except ValueError as error:
        raise tokens.error(f"{table.keyword}: {error}") from None
    if depth == len(slots):
        value = tokens.take_number()
        if table.keyword != "R":
            _check_range(tokens, value, value)
        table.specifications.set_block(prefix, value, line)
    elif table.keyword == "R" and len(slots) - depth > 2:
        raise tokens.error("R: must name at least an action and a state", line)
    elif tokens.peek() in SHAPES and table.keyword != "R":
        _set_shape(tokens, header, table, prefix, slots[depth:], line)
    else:
        _read_rows(tokens, table, prefix, slots[depth:], line)


def _take_head(tokens: Tokens, slots: Sequence[Slot]) -> tuple[Place, int]:
    """Take the words before the numbers, Cassandra's way; returns indices and slots filled."""
    prefix = slots[0].find(tokens.take())
    depth = 1
    while depth < len(slots) and tokens.peek() == ":":
        tokens.take()
        prefix += slots[depth].find(tokens.take())
        depth += 1
    return prefix, depth


def _take_joint_head(tokens: Tokens, slots: Sequence[Slot]) -> tuple[Place, int]:
    """Take the words before the numbers, MADP's way; the last one's colon is taken too."""
    prefix: Place = ()
    depth = 0
    while depth < len(slots) and tokens.more_on_line():
        if depth and tokens.peek() in SHAPES:
            break
        words = []
        while tokens.more_on_line() and (word := tokens.take()) != ":":
            words.append(word)
        prefix += slots[depth].find(" ".join(words))
        depth += 1
    if not depth:
        raise ValueError("an action must follow on the same line")
    return prefix, depth


def _set_shape(
    tokens: Tokens, header: Header, table: Table, prefix: Place, rest: Sequence[Slot], line: int
) -> None:
    """Carry out `uniform`, `identity` or `reset`."""
    shape = tokens.take()
    specifications = table.specifications
    if shape == "uniform":
        specifications.set_block(prefix, 1 / rest[-1].size, line)
        return
    if shape == "reset":
        if table.keyword != "T" or len(rest) != 1:
            raise tokens.error("'reset' may only be a row of T (T: action : state reset)")
        offsets = header.start_states
        values = header.start[offsets]
    else:
        if len(rest) != 2 or rest[0].size != rest[1].size:
            raise tokens.error("'identity' may only be a square matrix")
        values = np.ones(rest[0].size)
        offsets = np.arange(rest[0].size) * (rest[0].size + 1)
    specifications.set_block(prefix, 0.0, line)
    specifications.set_entries(prefix, offsets, values, line)


def _read_rows(
    tokens: Tokens, table: Table, prefix: Place, rest: Sequence[Slot], line: int
) -> None:
    """Read a row over the last slot, or a matrix over the last two, one row at a time."""
    specifications = table.specifications
    specifications.set_block(prefix, 0.0, line)
    columns = rest[-1].size
    for row in range(math.prod(slot.size for slot in rest[:-1])):
        values = tokens.take_numbers(columns)
        if table.keyword != "R":
            _check_range(tokens, values.min(), values.max())
        offsets = np.flatnonzero(values)
        specifications.set_entries(prefix, row * columns + offsets, values[offsets], tokens.line)


def _check_range(tokens: Tokens, smallest: float, largest: float) -> None:
    """Check that the extremes of some probabilities are probabilities."""
    if smallest < 0 or largest > 1 + SUM_TOLERANCE:
        worst = smallest if smallest < 0 else largest
        raise tokens.error(f"probability {worst} must lie in [0, 1]")
