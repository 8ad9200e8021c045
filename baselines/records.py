"""What a run leaves behind: one line of JSON per evaluation point, a policy file, an error text.

Lines are appended, flushed and synchronised one at a time, so that whatever happens to the
process every complete line is good. Everything read back is checked as if a stranger wrote it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from baselines.files import lock_file, parse_json

LINE_LIMIT = 2**20
"""Longest line in bytes that is read."""


class RecordError(ValueError):
    """A file of an experiment's folder that is not what it should be: `FILE:LINE: reason`."""


@dataclass(frozen=True)
class Record:
    """One evaluation of one run; its fields are the keys of a line.

    Attributes:
        contender: name of the entry in the experiment.
        seed: index of the run's seed, counted from 0.
        episodes: training episodes so far.
        steps: environment steps of training so far.
        train_seconds: wall-clock of training so far, evaluations not counted.
        eval_seconds: wall-clock of evaluations so far.
        return_mean: mean discounted return of the evaluation episodes.
        return_std: their standard deviation.
        length_mean: their mean length in steps.
        eval_episodes: their number.
        exact_value: the policy's exact value, None where the model is not known.
        metrics: what the learner reported last.
        final: whether this is the run's last line; a run without one is not finished.
        reward_mean: mean of the evaluation episodes' sums of rewards, not discounted; None in
            records of earlier versions.
        train_reward: sum of the rewards earned in training so far, exploration included; None
            where nobody counted.
        train_return: mean discounted return of the training episodes so far, exploration included;
            None where nobody counted.
    """

    contender: str
    seed: int
    episodes: int
    steps: int
    train_seconds: float
    eval_seconds: float
    return_mean: float
    return_std: float
    length_mean: float
    eval_episodes: int
    exact_value: float | None
    metrics: dict[str, float]
    final: bool
    reward_mean: float | None = None
    train_reward: float | None = None
    train_return: float | None = None

    def line(self) -> bytes:
        """Return the record as one line of JSON."""
        return json.dumps(dataclasses.asdict(self), allow_nan=False).encode() + b"\n"


@dataclass(frozen=True)
class Records:
    """The lines of one file; `size` is the length in bytes of its complete part."""

    lines: tuple[Record, ...]
    size: int
    torn: bool

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return bool(self.lines) and self.lines[-1].final


@dataclass(frozen=True)
class RunFiles:
    """The files of one run below an experiment's folder."""

    folder: Path
    contender: str
    seed: int

    @property
    def _stem(self) -> Path:
        return self.folder / "runs" / self.contender / str(self.seed)

    @property
    def name(self) -> str:
        """How messages call the run."""
        return f"{self.contender}/{self.seed}"

    @property
    def records(self) -> Path:
        """The lines."""
        return self._stem.with_name(f"{self.seed}.jsonl")

    @property
    def error(self) -> Path:
        """The traceback of a run that failed."""
        return self._stem.with_name(f"{self.seed}.error.txt")

    def failure(self) -> str:
        """Return the last line of the traceback; empty if there is none that can be read."""
        try:
            return self.error.read_text(errors="replace").strip().rpartition("\n")[2]
        except OSError:
            return ""

    @property
    def progress(self) -> Path:
        """How much of its budget the run has used, between two of its lines; gone at its end."""
        return self._stem.with_name(f".{self.seed}.progress")

    def policy(self, suffix: str) -> Path:
        """The policy learned; the suffix says by which library."""
        return self._stem.with_name(f"{self.seed}.policy{suffix}")

    def find_policy(self) -> Path | None:
        """Return the policy file that is there, None if there is none."""
        found = (self.policy(suffix) for suffix in (".npz", ".zip"))
        return next((path for path in found if path.exists()), None)

    def read(self) -> Records:
        """Read the lines; a run that has not begun has none.

        Raises:
            RecordError: a complete line is damaged.
        """
        if not self.records.exists():
            return Records((), 0, False)
        found = read_records(self.records)
        for number, line in enumerate(found.lines, 1):
            if (line.contender, line.seed) != (self.contender, self.seed):
                raise RecordError(
                    f"{self.records}:{number}: belongs to {line.contender}/{line.seed}"
                )
        return found


class RunLog:
    """The file of one run, open for appending; no other process writes to it meanwhile."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def restart(self) -> None:
        """Throw away what an unfinished run left."""
        self._file.truncate(0)

    def append(self, record: Record) -> None:
        """Write one line; when this returns the line survives a crash of the machine."""
        self._file.write(record.line())
        self._file.flush()
        os.fsync(self._file.fileno())


@contextlib.contextmanager
def open_log(path: Path) -> Iterator[RunLog]:
    """Open a run's file, waiting for a writer that an earlier, killed command left behind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        lock_file(file, wait=True)
        yield RunLog(file)


def is_being_written(path: Path) -> bool:
    """Return whether a process has opened a run's file by `open_log`."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return not lock_file(file, wait=False)


def read_records(path: Path) -> Records:
    """Read a file of records without a torn last line; `Records.torn` tells of one.

    Torn is what has no line end, as a kill in the middle of a line leaves it. A line that has one
    was written by someone else if it is no record, and is not dropped in silence.

    Raises:
        RecordError: a line is too long, is not a record, or holds a number that is not finite.
        OSError: the file cannot be read.
    """
    lines: list[Record] = []
    size = 0
    with path.open("rb") as file:
        for number, text in enumerate(iter(lambda: file.readline(LINE_LIMIT + 1), b""), 1):
            where = f"{path}:{number}"
            if len(text) > LINE_LIMIT:
                raise RecordError(f"{where}: line longer than {LINE_LIMIT} bytes")
            if not text.endswith(b"\n"):
                return Records(tuple(lines), size, True)
            lines.append(_record(parse_json(text), where))
            size += len(text)
    return Records(tuple(lines), size, False)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300 and math.isfinite(value)


def _is_number_or_null(value: Any) -> bool:
    return value is None or _is_number(value)


def _is_metrics(value: Any) -> bool:
    return isinstance(value, dict) and all(_is_number(number) for number in value.values())


_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "contender": (lambda value: isinstance(value, str), "a name"),
    "seed": (_is_count, "a count"),
    "episodes": (_is_count, "a count"),
    "steps": (_is_count, "a count"),
    "train_seconds": (_is_number, "a finite number"),
    "eval_seconds": (_is_number, "a finite number"),
    "return_mean": (_is_number, "a finite number"),
    "return_std": (_is_number, "a finite number"),
    "length_mean": (_is_number, "a finite number"),
    "eval_episodes": (_is_count, "a count"),
    "exact_value": (_is_number_or_null, "a finite number or null"),
    "metrics": (_is_metrics, "an object of finite numbers"),
    "final": (lambda value: isinstance(value, bool), "true or false"),
    "reward_mean": (_is_number_or_null, "a finite number or null"),
    "train_reward": (_is_number_or_null, "a finite number or null"),
    "train_return": (_is_number_or_null, "a finite number or null"),
}


def _record(value: Any, where: str) -> Record:
    if not isinstance(value, dict):
        raise RecordError(f"{where}: not a record")
    value = {"reward_mean": None, "train_reward": None, "train_return": None} | value
    for key in value.keys() ^ _CHECKS.keys():
        raise RecordError(f"{where}: key {key!r} {'is unknown' if key in value else 'is missing'}")
    for key, (check, wanted) in _CHECKS.items():
        if not check(value[key]):
            raise RecordError(f"{where}: {key} must be {wanted}")
    return Record(**value)
