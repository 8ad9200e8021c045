"""The command `status`: what of an experiment is done, running, failed or still to come."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.experiment import Experiment
from baselines.records import Record, RecordError, RunFiles, is_being_written
from baselines.report import DASH, number, print_table
from baselines.study import load_study, read_runs, study_folders
from baselines.usage import UsageError, usage_errors

if TYPE_CHECKING:
    from baselines.options import Status

DONE, RUNNING, FAILED, STOPPED, WAITING = "done", "running", "failed", "stopped", "waiting"
HEADER = ["run", "state", "share", "mean", "train seconds", "seconds left"]


def status(options: Status) -> int:
    """Print the state of every run below a folder; return 1 if one failed, else 0."""
    failed: list[RunFiles] = []
    damaged: list[str] = []
    with usage_errors(RecordError):
        places = study_folders(options.folder)
    for place in places:
        try:
            with usage_errors(RecordError):
                failed += _print_states(place)
        except UsageError as error:
            damaged.append(str(error))
    for files in failed:
        print(f"failed: {files.name} ({files.failure()}); traceback in {files.error}")
    if damaged:
        raise UsageError("; ".join(damaged))
    return 1 if failed else 0


def _print_states(place: Path) -> list[RunFiles]:
    """Print the state of every run of an experiment; return those that failed."""
    experiment = load_study(place).experiment
    runs = read_runs(experiment, place)
    states = {files: _state(files, found.finished) for files, found in runs.items()}
    counts = [list(states.values()).count(s) for s in (DONE, RUNNING, FAILED)]
    print(
        f"{place}: {experiment.environment.id}, {len(runs)} runs of {experiment.budget:,} "
        f"{experiment.unit}: {counts[0]} done, {counts[1]} running, {counts[2]} failed"
    )
    rows = [_row(experiment, files, states[files], found.lines) for files, found in runs.items()]
    print_table([HEADER, *rows])
    return [files for files, state in states.items() if state == FAILED]


def _state(files: RunFiles, finished: bool) -> str:
    """Return what a run is doing; only the process that does it holds its file."""
    if is_being_written(files.records):
        return RUNNING
    if finished:
        return DONE
    if files.error.exists():
        return FAILED
    return STOPPED if files.records.exists() else WAITING


def _row(experiment: Experiment, files: RunFiles, state: str, lines: Sequence[Record]) -> list[str]:
    """Return the cells of a run; the time left is that of its pace so far, evaluations included."""
    if not lines:
        return [files.name, state, *[DASH] * 4]
    last = lines[-1]
    share = 1.0 if last.final else min(1.0, getattr(last, experiment.unit) / experiment.budget)
    spent = last.train_seconds + last.eval_seconds
    left = spent * (1.0 / share - 1.0) if share and state == RUNNING else None
    return [
        files.name,
        state,
        f"{share:.0%}",
        number(last.return_mean, ".3f"),
        number(last.train_seconds, ",.1f"),
        number(left, ",.0f"),
    ]
