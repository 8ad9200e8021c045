"""An experiment in its folder: begun, resumed, extended, and never mixed with another."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import logging
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.files import parse_json, write_atomic
from baselines.own import is_own
from baselines.records import RecordError, Records, RunFiles

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

_log = logging.getLogger(__name__)


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


def trusted_environment(study: Study) -> EnvironmentSpec:
    """Return the environment that a record names, unless making it would import a module.

    Raises:
        ValueError: it would; only the command line may name one.
    """
    environment = study.experiment.environment
    if is_own(environment.id):
        raise ValueError(
            f"the folder names a module to import; allow it with --env {environment.id}"
        )
    return environment


def is_reproduction(folder: Path) -> bool:
    """Return whether `reproduce` made a folder, whose panels may all be computed, not recorded."""
    return (folder / "summary.json").is_file() and not (folder / FILE).is_file()


def study_folders(folder: Path, *, required: bool = True) -> list[Path]:
    """Return the folders of experiments: this one, or those in it that `reproduce` made.

    Raises:
        RecordError: there is none, though one is required.
    """
    if (folder / FILE).is_file():
        return [folder]
    if required and not folder.is_dir():
        raise RecordError(f"{folder}: there is no such folder")
    below = sorted(path.parent for path in folder.glob(f"*/{FILE}"))
    if required and not below:
        raise RecordError(f"{folder}: holds no experiment ({FILE} is missing)")
    return below


def _read(folder: Path) -> tuple[dict[str, Any], Study]:
    path = folder / FILE
    if not path.is_file():
        raise RecordError(f"{folder}: holds no experiment ({FILE} is missing)")
    values: Any = parse_json(path.read_bytes()) if path.stat().st_size <= FILE_LIMIT else None
    if not isinstance(values, dict):
        raise RecordError(f"{path}: not an experiment (no JSON object of at most 16 MiB)")
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
    for name, value in wanted.items():
        if name not in ("entries", "seeds"):
            _check_equal(folder, name, values.get(name), value)
    known = {entry.name: entry for entry in old.entries}
    for entry in new.entries:
        if entry.name in known:
            before = known[entry.name]
            _check_equal(folder, f"{entry.name}.contender", before.contender, entry.contender)
            for key in sorted(before.settings.keys() | entry.settings.keys()):
                here, there = before.settings.get(key), entry.settings.get(key)
                _check_equal(folder, f"{entry.name}.{key}", here, there)
    given = {entry.name for entry in new.entries}
    for entry in old.entries:
        if is_own(entry.contender) and entry.name not in given:
            raise ValueError(
                f"{folder} has runs of {entry.contender}; name that too, for it to be imported"
            )
    added = tuple(entry for entry in new.entries if entry.name not in known)
    seeds = max(old.seeds, new.seeds)
    return dataclasses.replace(old, entries=old.entries + added, seeds=seeds)


def _check_equal(folder: Path, name: str, here: Any, wanted: Any) -> None:
    if here != wanted:
        raise ValueError(
            f"{folder} holds another experiment: {name} is {json.dumps(here)} there, "
            f"{json.dumps(wanted)} here"
        )


def read_runs(
    experiment: Experiment, folder: Path, *, repair: bool = False
) -> dict[RunFiles, Records]:
    """Read the records of every run; a torn last line is dropped with a warning.

    Args:
        experiment: whose runs.
        folder: where they are.
        repair: cut torn lines off the files too.

    Raises:
        RecordError: a complete line of a file is damaged.
    """
    runs = {}
    for entry in experiment.entries:
        for index in range(experiment.seeds):
            files = RunFiles(folder, entry.name, index)
            runs[files] = found = files.read()
            if found.torn:
                _log.warning("%s:%d: torn last line dropped", files.records, len(found.lines) + 1)
                if repair:
                    os.truncate(files.records, found.size)
    return runs


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that matter, as far as installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
