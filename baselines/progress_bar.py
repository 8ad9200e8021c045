"""One progress bar over all runs, moved by what their records say, and between these by notes.

A run notes how far it is in a small file beside its records, which all who see the folder can read.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

from tqdm import tqdm

from baselines.experiment import Experiment
from baselines.files import parse_json
from baselines.records import RunFiles

POLL_SECONDS = 0.5
"""Time between two looks at the records, and at least between two notes of a run."""
LOG_SECONDS = 30.0
"""Time between two lines of progress where nobody looks: in a file or a pipe."""
STARTING = "starting (the first use compiles)"
"""What the bar says while no run that is under way has come to its first update."""


@contextlib.contextmanager
def progress_bar(
    experiment: Experiment, every: Sequence[RunFiles], *, shown: bool
) -> Iterator[None]:
    """Follow all runs by their records while the block lasts."""
    if not shown:
        yield
        return
    ended = threading.Event()
    total = experiment.budget * len(every)
    pause = 0.1 if sys.stderr.isatty() else LOG_SECONDS
    with tqdm(
        desc=STARTING,
        total=total,
        unit=f" {experiment.unit}",
        unit_scale=True,
        smoothing=0.05,
        mininterval=pause,
        maxinterval=2 * pause,
    ) as bar:
        bar.update(sum(budget_used(experiment, files) for files in every))
        watcher = threading.Thread(target=_watch, args=(bar, experiment, every, ended), daemon=True)
        watcher.start()
        try:
            yield
        finally:
            ended.set()
            watcher.join()


def _watch(
    bar: Any, experiment: Experiment, every: Sequence[RunFiles], ended: threading.Event
) -> None:
    """Move the bar until the end is announced, and once more."""
    used: dict[RunFiles, int] = dict.fromkeys(every, 0)
    last, shown = False, 0.0
    while not last:
        last = ended.wait(POLL_SECONDS)
        for files in every:
            if used[files] != experiment.budget:
                used[files] = budget_used(experiment, files)
        finished = sum(steps == experiment.budget for steps in used.values())
        moving = any(files.progress.exists() for files in every)
        bar.set_description(None if moving or last else STARTING, refresh=False)
        bar.set_postfix_str(f"{finished}/{len(every)} runs", refresh=False)
        bar.n = sum(used.values())
        if last or time.monotonic() - shown >= bar.mininterval:
            shown = time.monotonic()
            bar.refresh()


def note(files: RunFiles, used: int) -> None:
    """Note how much of its budget a run has used; what cannot be written is only not shown."""
    partial = files.progress.with_suffix(".partial")
    with contextlib.suppress(OSError):
        partial.write_text(str(used))
        partial.replace(files.progress)


def budget_used(experiment: Experiment, files: RunFiles) -> int:
    """Return how much of its budget a run has used; all of it only once its last line is there."""
    record = _last_record(files)
    if record.get("final") is True:
        return experiment.budget
    try:
        noted = int(files.progress.read_text())
    except (OSError, ValueError):
        noted = 0
    recorded = record.get(experiment.unit)
    return min(max(noted, recorded if isinstance(recorded, int) else 0), experiment.budget - 1)


def _last_record(files: RunFiles) -> dict[str, Any]:
    """Return the last line of a run that may be writing it, as it is; {} if there is none."""
    try:
        last = files.records.read_bytes().splitlines()[-1:]
    except OSError:
        return {}
    value = parse_json(last[0]) if last else None
    return value if isinstance(value, dict) else {}
