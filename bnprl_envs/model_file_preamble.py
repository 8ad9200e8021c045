"""The preamble of a model file: sizes, names, discount, start."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import TypeVar

import numpy as np

from bnprl_envs.model_file_labels import MAX_SIZE, Labels, is_numeric, near_misses
from bnprl_envs.model_file_specifications import IntArray
from bnprl_envs.model_file_tokens import Tokens, as_numbers, number, shown
from bnprl_envs.tables import SUM_TOLERANCE, FloatArray

MAX_ROWS = 2**22
"""Largest number of rows A * S of a table that a file may declare."""

MAX_AGENTS = 32
"""Largest number of agents; with two actions each, `MAX_SIZE` allows 20."""

PREAMBLE = ("discount", "values", "states", "actions", "observations", "start", "agents")
TABLES = ("T", "O", "R")
KEYWORDS = (*PREAMBLE, *TABLES, "E")

Parsed = TypeVar("Parsed")


@dataclass(frozen=True)
class Item:
    """A preamble statement: its words with their lines.

    Attributes:
        keyword: the word before the colon; `start include` and `start exclude` are two words.
        line: its line.
        words: (line, word) of all words after the colon.
    """

    keyword: str
    line: int
    words: tuple[tuple[int, str], ...]

    @property
    def texts(self) -> list[str]:
        """The words without their lines."""
        return [word for _, word in self.words]

    def rows(self) -> list[list[str]]:
        """Return the words of each line that has any."""
        lines = groupby(self.words, key=itemgetter(0))
        return [[word for _, word in words] for _, words in lines]


_ONE_AGENT = Item("agents", 1, ((1, "1"),))
_UNIFORM = Item("start", 1, ((1, "uniform"),))
"""Stand for the lines that a file leaves out."""


@dataclass(frozen=True)
class Header:
    """What the preamble says.

    Attributes:
        multi_agent: whether an `agents:` line is there (MADP's grammar).
        discount: in (0, 1].
        sign: -1 where the numbers are costs.
        states: S labels.
        actions: labels of each agent's actions.
        observations: labels of each agent's observations; None for a fully observed model.
        agents: names of the agents.
        start: (S,) distribution.
    """

    multi_agent: bool
    discount: float
    sign: float
    states: Labels
    actions: tuple[Labels, ...]
    observations: tuple[Labels, ...] | None
    agents: tuple[str, ...]
    start: FloatArray

    @cached_property
    def start_states(self) -> IntArray:
        """The states that an episode may start in."""
        return np.flatnonzero(self.start)


def take_item(tokens: Tokens, keyword: str, line: int) -> tuple[Item, tuple[str, int]]:
    """Take the words after `keyword:` up to the next keyword, whose colon is taken as well.

    Returns:
        The item, and the next keyword with its line; "" at the end of the file.
    """
    words: list[tuple[int, str]] = []
    while tokens.peek() and tokens.peek() != ":":
        word = tokens.take()
        words.append((tokens.line, word))
    following = ("", tokens.line)
    if tokens.peek():
        following = _pop_keyword(tokens, words)
        tokens.take_colon()
    return Item(keyword, line, tuple(words)), following


def read_preamble(tokens: Tokens) -> tuple[Header, list[Item], tuple[str, int]]:
    """Read up to the first `T:`, `O:` or `R:`.

    Returns:
        The header, the `E:` items (terminal states), and the next keyword with its line.

    Raises:
        ModelFileError: a statement is malformed, repeated or missing.
    """
    before, (keyword, line) = take_item(tokens, "", 1)
    if before.words:
        raise tokens.error("text before the first keyword", before.words[0][0])
    items: dict[str, Item] = {}
    terminal: list[Item] = []
    while keyword and keyword not in TABLES:
        item, following = take_item(tokens, keyword, line)
        base = keyword.split()[0]
        if keyword == "E":
            terminal.append(item)
        elif base in items:
            raise tokens.error(f"'{base}:' is given twice", line)
        else:
            items[base] = item
        keyword, line = following
    return _header(tokens, items, line), terminal, (keyword, line)


def _pop_keyword(tokens: Tokens, words: list[tuple[int, str]]) -> tuple[str, int]:
    """Take the keyword that ends just before a colon off the words."""
    if not words:
        raise tokens.error("expected a keyword before the colon")
    line, word = words.pop()
    if word in ("include", "exclude") and words and words[-1][1] == "start":
        line, start = words.pop()
        return f"{start} {word}", line
    if word not in KEYWORDS:
        raise tokens.error(f"unknown keyword {shown(word)}{near_misses(word, KEYWORDS)}", line)
    return word, line


def _header(tokens: Tokens, items: dict[str, Item], line: int) -> Header:
    """Make the header of the preamble's items; `line` is where the preamble ends."""
    for keyword in ("discount", "values", "states", "actions"):
        if keyword not in items:
            raise tokens.error(f"the preamble has no '{keyword}:'", line)
    agents = _at(tokens, items.get("agents", _ONE_AGENT), _agents)
    by_line = "agents" in items
    states = _at(tokens, items["states"], lambda item: Labels.parse("state", item.texts))
    actions = _at(
        tokens, items["actions"], lambda item: _per_agent("action", item, by_line, agents)
    )
    observations = None
    if "observations" in items:
        observations = _at(
            tokens,
            items["observations"],
            lambda item: _per_agent("observation", item, by_line, agents),
        )
    _at(tokens, items["states"], lambda _: _check_sizes(states, actions, observations))
    return Header(
        multi_agent=by_line,
        discount=_at(tokens, items["discount"], _discount),
        sign=_at(tokens, items["values"], _sign),
        states=states,
        actions=actions,
        observations=observations,
        agents=agents,
        start=_at(tokens, items.get("start", _UNIFORM), lambda item: _start(item, states)),
    )


def _at(tokens: Tokens, item: Item, parse: Callable[[Item], Parsed]) -> Parsed:
    """Return what an item says, a ValueError turned into the error of the item's line."""
    try:
        return parse(item)
    except ValueError as error:
        raise tokens.error(str(error), item.line) from None


def _discount(item: Item) -> float:
    if len(item.words) != 1:
        raise ValueError(f"discount: {len(item.words)} words, must be one number")
    discount = number(item.texts[0])
    if not 0 < discount <= 1:
        raise ValueError(f"discount: {discount}, must lie in (0, 1]")
    return discount


def _sign(item: Item) -> float:
    if item.texts not in (["reward"], ["cost"]):
        raise ValueError(f"values: {shown(' '.join(item.texts))}, must be 'reward' or 'cost'")
    return 1.0 if item.texts == ["reward"] else -1.0


def _agents(item: Item) -> tuple[str, ...]:
    """Return the agents' names: given, or `agent_0`, ... for a count."""
    labels = Labels.parse("agent", [word.rstrip(",") for word in item.texts])
    if len(labels.names) > MAX_AGENTS:
        raise ValueError(f"agents: {len(labels.names):,}, the limit is {MAX_AGENTS}")
    by_count = len(item.words) == 1 and is_numeric(item.texts[0])
    return tuple(f"agent_{n}" for n in labels.names) if by_count else labels.names


def _per_agent(kind: str, item: Item, by_line: bool, agents: Sequence[str]) -> tuple[Labels, ...]:
    """Return each agent's labels: one line an agent, or all words for the one agent."""
    rows = item.rows() if by_line else [item.texts]
    if len(rows) != len(agents):
        raise ValueError(
            f"{kind}s: {len(rows)} lines, must be one for each of the {len(agents)} agents"
        )
    labels: list[Labels] = []
    size = 1
    for row in rows:
        labels.append(Labels.parse(kind, row))
        size *= len(labels[-1].names)
        if size > MAX_SIZE:
            raise ValueError(f"{size:,} joint {kind}s, the limit is {MAX_SIZE:,}")
    return tuple(labels)


def _check_sizes(
    states: Labels, actions: Sequence[Labels], observations: Sequence[Labels] | None
) -> None:
    n_states = len(states.names)
    n_actions = math.prod(len(labels.names) for labels in actions)
    n_observations = math.prod(len(labels.names) for labels in observations or ())
    if n_actions * n_states > MAX_ROWS:
        raise ValueError(
            f"{n_actions:,} actions times {n_states:,} states, the limit is {MAX_ROWS:,}"
        )
    if n_actions * n_states * n_states * n_observations >= 2**62:
        raise ValueError("the numbers of states, actions and observations are too large together")


def _start(item: Item, states: Labels) -> FloatArray:
    """Return the start distribution: a row, `uniform`, one state or a subset of states."""
    words = item.texts
    size = len(states.names)
    row = np.zeros(size)
    if item.keyword != "start":
        row[states.find_all(words)] = 1.0
        row = row if item.keyword == "start include" else 1.0 - row
        if not row.any():
            raise ValueError(f"{item.keyword}: no state is left")
        return np.asarray(row / row.sum())
    if words == ["uniform"]:
        return np.full(size, 1.0 / size)
    if len(words) == 1 and (size > 1 or not is_numeric(words[0]) or words[0] == "0"):
        row[states.find(words[0])] = 1.0
        return row
    if len(words) != size:
        raise ValueError(f"start: {len(words)} words, must be {size} probabilities or one state")
    row = as_numbers(words)
    if row.min() < 0 or row.max() > 1 + SUM_TOLERANCE:
        worst = row.min() if row.min() < 0 else row.max()
        raise ValueError(f"start: probability {worst}, must lie in [0, 1]")
    if abs(row.sum() - 1) > SUM_TOLERANCE:
        raise ValueError(f"start: sums to {row.sum():.9g}, must be 1 within {SUM_TOLERANCE:g}")
    return row
