"""An experiment is data: environment, contenders with settings, budget, seeds, evaluation."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.contenders import Contender, contender
from baselines.environment import EnvironmentSpec
from baselines.files import check_name
from baselines.own import is_own

METRIC = "mean discounted return"

MOST = {"seeds": 10_000, "eval_points": 10_000}
"""Of what a slip of the finger would otherwise keep a machine busy for ever."""
MOST_RUNS = 100_000
"""Of all agents together."""


@dataclass(frozen=True)
class Entry:
    """One line of the comparison: a contender with its settings.

    Attributes:
        name: what tables call it, and the folder of its runs.
        contender: which learner.
        settings: field -> value, as JSON values; fields that are left out keep their defaults.

    Raises:
        ValueError: an unknown contender, an unknown setting, or a name that is no folder.
    """

    name: str
    contender: str
    settings: dict[str, Any]

    def __post_init__(self) -> None:
        check_name(self.name)
        if is_own(self.contender):
            return  # what a stranger's record names is not imported
        known = [field.name for field in dataclasses.fields(self.learner.settings)]
        for key in self.settings.keys() - set(known):
            near = difflib.get_close_matches(key, known)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
            hint = hint if known else "it has none"
            raise ValueError(f"{self.name}: unknown setting {key!r}; {hint}")

    @staticmethod
    def of(name: str, settings: Any = None, label: str | None = None) -> Entry:
        """Take a contender by name, with its default settings unless others are given.

        An own agent "module:class" is labelled by its class.

        Raises:
            ValueError: there is no such contender.
        """
        chosen = contender(name).settings if settings is None else settings
        values = json.loads(json.dumps(dataclasses.asdict(chosen)))
        return Entry(name.rpartition(":")[2] if label is None else label, name, values)

    @property
    def learner(self) -> Contender:
        """The contender itself."""
        return contender(self.contender)

    def build_settings(self) -> Any:
        """Return the settings as the contender's dataclass.

        Raises:
            ValueError: a value is not one that the contender takes.
        """
        values = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in self.settings.items()
        }
        try:
            return dataclasses.replace(self.learner.settings, **values)
        except TypeError as error:
            raise ValueError(f"{self.name}: {error}") from error


def configured_entries(names: Sequence[str], assignments: Sequence[str]) -> tuple[Entry, ...]:
    """Take contenders by name, with some settings assigned as AGENT.FIELD=VALUE.

    Raises:
        ValueError: an assignment is malformed, or names another agent, an unknown setting or a
            value of another type.
    """
    entries = {entry.name: entry for entry in map(Entry.of, names)}
    paths = [text.partition("=")[0] for text in assignments]
    for text in assignments:
        path, equals, value = text.partition("=")
        if paths.count(path) > 1:
            raise ValueError(f"--set {path}: is given {paths.count(path)} times")
        name, _, field = path.partition(".")
        if not equals or name not in entries:
            raise ValueError(
                f"--set {text}: must be AGENT.FIELD=VALUE, AGENT one of {', '.join(entries)}"
            )
        old = entries[name].settings
        new = dataclasses.replace(
            entries[name], settings=old | {field: _setting(text, value, old.get(field))}
        )
        new.build_settings()
        entries[name] = new
    if len(entries) < len(names):
        raise ValueError(f"an agent is given twice: {' '.join(names)}")
    return tuple(entries.values())


def _setting(text: str, value: str, default: Any) -> Any:
    """Return a setting's value as what its default is; one of None or a word may be a number."""
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[value.lower()]
        if isinstance(default, list):
            parts = [part.strip() for part in value.strip("[]").split(",") if part.strip()]
            return [_number(part, default[0] if default else 0.0) for part in parts]
        if default is None or isinstance(default, str):
            with contextlib.suppress(ValueError):
                return _number(value, 0)
            return value
        return type(default)(value)
    except (ValueError, KeyError):
        wanted = {bool: "true or false", int: "a whole number", float: "a number"}
        kind = wanted.get(type(default), "a list of numbers, as in .1,.2")
        raise ValueError(f"--set {text}: {value!r} must be {kind}") from None


def _number(text: str, like: Any) -> Any:
    """Return a number, whole if it is written so and `like` is whole; a word if `like` is one."""
    if isinstance(like, str):
        return text
    if isinstance(like, int):
        with contextlib.suppress(ValueError):
            return int(text)
    return float(text)


@dataclass(frozen=True)
class Experiment:
    """Everything that decides the numbers of a comparison.

    Attributes:
        environment: where all learn and are evaluated.
        entries: the contenders, in the order of the tables.
        episodes: budget of training episodes of each run, or None.
        steps: budget of environment steps of each run, or None; exactly one of the two.
        seeds: runs of each contender.
        root_seed: from which the seeds of all runs are derived.
        eval_episodes: episodes of each evaluation.
        eval_points: evaluations of each run, evenly spread over the budget.

    Raises:
        ValueError: a number is not positive or too large, both budgets or neither are given, no
            contender or one twice.
    """

    environment: EnvironmentSpec
    entries: tuple[Entry, ...]
    episodes: int | None = None
    steps: int | None = None
    seeds: int = 1
    root_seed: int = 0
    eval_episodes: int = 1000
    eval_points: int = 10

    def __post_init__(self) -> None:
        if (self.episodes is None) == (self.steps is None):
            raise ValueError("give exactly one of --episodes and --steps")
        for name in ("episodes", "steps", "seeds", "eval_episodes", "eval_points"):
            value, most = getattr(self, name), MOST.get(name, 2**53 - 1)
            if value is not None and not (isinstance(value, int) and 1 <= value <= most):
                raise ValueError(f"--{name.replace('_', '-')}: {value}, must lie in 1 to {most}")
        if self.root_seed < 0:
            raise ValueError(f"--seed: {self.root_seed}, must be at least 0")
        names = [entry.name for entry in self.entries]
        if not names:
            raise ValueError("no agent is given")
        if len(names) * self.seeds > MOST_RUNS:
            raise ValueError(f"{len(names) * self.seeds:,} runs, the limit is {MOST_RUNS:,}")
        if len(set(names)) < len(names):
            twice = next(name for name, count in Counter(names).items() if count > 1)
            raise ValueError(f"agent {twice!r} is given twice")

    @property
    def budget(self) -> int:
        """Episodes or steps of each run."""
        return self.episodes or self.steps or 0

    @property
    def unit(self) -> str:
        """What the budget counts."""
        return "steps" if self.episodes is None else "episodes"

    def entry(self, name: str) -> Entry:
        """Return the entry of a name.

        Raises:
            KeyError: there is none.
        """
        return next(entry for entry in self.entries if entry.name == name)

    def run_seeds(self, name: str, index: int) -> tuple[int, np.random.SeedSequence]:
        """Return the seeds of one run: of its training and of its evaluations."""
        root = np.random.SeedSequence([self.root_seed, zlib.crc32(name.encode()), index])
        training, evaluation = root.spawn(2)
        return int(training.generate_state(1)[0] >> 1), evaluation

    def to_json(self) -> dict[str, Any]:
        """Return the experiment as JSON values."""
        return dataclasses.asdict(self) | {
            "entries": [dataclasses.asdict(entry) for entry in self.entries],
            "metric": METRIC,
            "model_sha256": _digest(self.environment.id),
        }


def _digest(id: str) -> str | None:
    """Return the digest of a model file, None for an id."""
    path = Path(id)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
