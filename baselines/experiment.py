"""An experiment is data: environment, contenders with settings, budget, seeds, evaluation."""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import importlib.metadata
import json
import platform
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.contenders import Contender, contender
from baselines.evaluation import EnvironmentSpec
from baselines.records import RecordError, check_name, parse_json, write_atomic

METRIC = "mean discounted return"
FILE = "experiment.json"
FILE_LIMIT = 2**24
"""Largest size in bytes of an experiment's file that is read."""
PACKAGES = (
    "bnprl",
    "numpy",
    "scipy",
    "numba",
    "gymnasium",
    "pettingzoo",
    "joblib",
    "torch",
    "stable-baselines3",
    "sb3-contrib",
)
"""Whose versions are kept with the results."""


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
        known = [field.name for field in dataclasses.fields(self.learner.settings)]
        for key in self.settings.keys() - set(known):
            near = difflib.get_close_matches(key, known)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
            raise ValueError(f"{self.name}: unknown setting {key!r}; {hint}")

    @staticmethod
    def of(name: str, settings: Any = None, label: str | None = None) -> Entry:
        """Take a contender by name, with its default settings unless others are given."""
        chosen = contender(name).settings if settings is None else settings
        values = json.loads(json.dumps(dataclasses.asdict(chosen)))
        return Entry(name if label is None else label, name, values)

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
        ValueError: a number is not positive, both budgets or neither are given, no contender or
            one twice.
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
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int) and 1 <= value < 2**53):
                raise ValueError(f"--{name.replace('_', '-')}: {value}, must be at least 1")
        if self.root_seed < 0:
            raise ValueError(f"--seed: {self.root_seed}, must be at least 0")
        names = [entry.name for entry in self.entries]
        if not names:
            raise ValueError("no agent is given")
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"agent {name!r} is given twice")

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


@dataclass(frozen=True)
class Study:
    """An experiment in its folder.

    Attributes:
        folder: where its files are.
        experiment: what is compared; grows when contenders or seeds are added.
        commands: the commands that wrote to the folder, oldest first.
        versions: package -> version that the newest of them ran with.
    """

    folder: Path
    experiment: Experiment
    commands: tuple[str, ...] = ()
    versions: dict[str, str] = dataclasses.field(default_factory=dict)

    def save(self) -> None:
        """Write the experiment's file."""
        values = self.experiment.to_json() | {
            "commands": list(self.commands),
            "versions": self.versions,
        }
        write_atomic(self.folder / FILE, json.dumps(values, indent=2) + "\n")


def open_study(folder: Path, experiment: Experiment, command: str) -> Study:
    """Begin an experiment in a folder, or go on with the one that is there.

    Raises:
        ValueError: the folder holds another experiment; the message names the field.
        RecordError: the folder's experiment cannot be read.
    """
    study = Study(folder, experiment, (command,), package_versions())
    if (folder / FILE).exists():
        values, old = _read(folder)
        merged = _merge(folder, values, old.experiment, experiment)
        commands = tuple(dict.fromkeys((*old.commands, command)))
        study = dataclasses.replace(study, experiment=merged, commands=commands)
    study.save()
    return study


def load_study(folder: Path) -> Study:
    """Read the experiment of a folder.

    Raises:
        RecordError: there is none, or it is damaged.
    """
    return _read(folder)[1]


def _read(folder: Path) -> tuple[dict[str, Any], Study]:
    path = folder / FILE
    if not path.is_file():
        raise RecordError(f"{folder}: holds no experiment ({FILE} is missing)")
    values: Any = parse_json(path.read_bytes()) if path.stat().st_size <= FILE_LIMIT else None
    try:
        experiment = Experiment(
            environment=EnvironmentSpec(**values["environment"]),
            entries=tuple(Entry(**entry) for entry in values["entries"]),
            **{name: values[name] for name in _NUMBERS},
        )
        commands = tuple(str(command) for command in values["commands"])
        versions = {str(name): str(version) for name, version in values["versions"].items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise RecordError(f"{path}: not an experiment ({error})") from error
    return values, Study(folder, experiment, commands, versions)


_NUMBERS = ("episodes", "steps", "seeds", "root_seed", "eval_episodes", "eval_points")


def _merge(folder: Path, values: dict[str, Any], old: Experiment, new: Experiment) -> Experiment:
    """Return the union of two experiments that differ in contenders and seeds only."""
    wanted = new.to_json()
    for name in wanted.keys() - {"entries", "seeds"}:
        _check_equal(folder, name, values.get(name), wanted[name])
    known = {entry.name: entry for entry in old.entries}
    for entry in new.entries:
        if entry.name in known:
            before = known[entry.name]
            _check_equal(folder, f"{entry.name}.contender", before.contender, entry.contender)
            for key in sorted(before.settings.keys() | entry.settings.keys()):
                here, there = before.settings.get(key), entry.settings.get(key)
                _check_equal(folder, f"{entry.name}.{key}", here, there)
    added = tuple(entry for entry in new.entries if entry.name not in known)
    seeds = max(old.seeds, new.seeds)
    return dataclasses.replace(old, entries=old.entries + added, seeds=seeds)


def _check_equal(folder: Path, name: str, here: Any, wanted: Any) -> None:
    if here != wanted:
        raise ValueError(
            f"{folder} holds another experiment: {name} is {json.dumps(here)} there, "
            f"{json.dumps(wanted)} here"
        )


def _digest(id: str) -> str | None:
    """Return the digest of a model file, None for an id."""
    path = Path(id)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that matter, as far as installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
