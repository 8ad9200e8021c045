"""Finished runs of a benchmark, one line of JSON each, so that none is run twice."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from joblib import Parallel, delayed
from tqdm import tqdm

from baselines.contenders import contender


class Score(NamedTuple):
    """How one seed stands on its way.

    Attributes:
        steps: of the environment.
        value: of the policy.
        seconds: of the processor, spent on learning.
        nodes: of a team's largest controller; None of other policies.
    """

    steps: int
    value: float
    seconds: float
    nodes: int | None = None


class Run(NamedTuple):
    """What tells a run from all others, and how to make it."""

    description: dict[str, Any]
    make: Callable[[], list[Score]]

    @classmethod
    def of(
        cls, agent: str, environment: str, seed: int, make: Callable[[], list[Score]], **budget: Any
    ) -> Run:
        """Describe a contender's run with its default settings.

        Args:
            agent: name of the contender.
            environment: what it learns in.
            seed: of everything random.
            make: trains and scores it.
            budget: what else tells the run from others, as JSON values.

        Raises:
            ValueError: there is no such contender.
        """
        settings = dataclasses.asdict(contender(agent).settings)
        description = {
            "agent": agent,
            "settings": settings,
            "environment": environment,
            "seed": seed,
        }
        return cls(description | budget, make)


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

    def of(self, run: Run) -> list[Score]:
        """The scores of a run, from the file, or else made and kept."""
        if _key(run.description) not in self.known:
            self._keep(run, run.make())
        return self.known[_key(run.description)]

    def prepare(self, runs: Sequence[Run], jobs: int, *, shown: bool = False) -> None:
        """Make and keep all missing runs, several at once, each in a process of its own.

        Args:
            runs: the first begin first.
            jobs: processes.
            shown: whether to draw a progress bar.
        """
        missing = [run for run in runs if _key(run.description) not in self.known]
        made = Parallel(n_jobs=jobs, batch_size=1, return_as="generator_unordered")(
            delayed(_numbered)(number, run.make) for number, run in enumerate(missing)
        )
        for number, scores in tqdm(made, total=len(missing), desc="runs", disable=not shown):
            self._keep(missing[number], scores)

    def _keep(self, run: Run, scores: list[Score]) -> None:
        self.known[_key(run.description)] = scores
        if self.path is not None:
            known = [
                {key: value for key, value in score._asdict().items() if value is not None}
                for score in scores
            ]
            line = {"run": run.description, "scores": known}
            with self.path.open("a") as file:
                file.write(json.dumps(line, allow_nan=False) + "\n")


def _key(description: dict[str, Any]) -> str:
    return json.dumps(description, sort_keys=True)


def _numbered(number: int, make: Callable[[], list[Score]]) -> tuple[int, list[Score]]:
    return number, make()
