"""Finished runs of a benchmark, one line of JSON each, so that none is run twice."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple


class Score(NamedTuple):
    """How one seed stands on its way: environment steps, value, processor seconds of learning."""

    steps: int
    value: float
    seconds: float


class Records:
    """The finished runs, in a file of one line of JSON each.

    A run is known by what describes it; if anything of that differs, it is another. An unfinished
    last line is dropped.

    Args:
        path: of the file, which need not exist, nor its folder; None keeps nothing.

    Raises:
        ValueError: a complete line is no record.
        OSError: the file cannot be read or written.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.known: dict[str, list[Score]] = {}
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("a").close()  # fails now rather than after the first run
        content = path.read_bytes()
        complete = content[: content.rfind(b"\n") + 1]
        if complete != content:
            path.write_bytes(complete)
        for number, line in enumerate(complete.splitlines(), start=1):
            try:
                record = json.loads(line)
                self.known[_key(record["run"])] = [Score(**score) for score in record["scores"]]
            except (ValueError, TypeError, KeyError) as error:
                raise ValueError(f"{path}:{number}: no record of a run") from error

    def of(self, run: dict[str, Any], make: Callable[[], list[Score]]) -> list[Score]:
        """The scores of a run that is described so, from the file, or else made and kept."""
        if _key(run) not in self.known:
            scores = make()
            self.known[_key(run)] = scores
            if self.path is not None:
                line = {"run": run, "scores": [score._asdict() for score in scores]}
                with self.path.open("a") as file:
                    file.write(json.dumps(line, allow_nan=False) + "\n")
        return self.known[_key(run)]


def _key(run: dict[str, Any]) -> str:
    return json.dumps(run, sort_keys=True)
