"""One progress bar over all runs, moved by what their records say."""

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
"""Time between two looks at the records."""
LOG_SECONDS = 30.0
"""Time between two lines of progress where nobody looks: in a file or a pipe."""


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
        total=total,
        unit=f" {experiment.unit}",
        unit_scale=True,
        smoothing=0.05,
        mininterval=pause,
        maxinterval=2 * pause,
    ) as bar:
        bar.update(sum(_done(experiment, files) for files in every))
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
    finished: dict[RunFiles, int] = {}
    last, shown = False, 0.0
    while not last:
        last = ended.wait(POLL_SECONDS)
        for files in every:
            if finished.get(files) != experiment.budget:
                finished[files] = _done(experiment, files)
        runs = sum(done == experiment.budget for done in finished.values())
        bar.set_postfix_str(f"{runs}/{len(every)} runs", refresh=False)
        bar.n = sum(finished.values())
        if last or time.monotonic() - shown >= bar.mininterval:
            shown = time.monotonic()
            bar.refresh()


def _done(experiment: Experiment, files: RunFiles) -> int:
    """Return how much of its budget a run has used, as its records tell."""
    try:
        last = files.records.read_bytes().splitlines()[-1:]
    except OSError:
        return 0
    for text in last:
        value = parse_json(text)
        if isinstance(value, dict) and value.get("final") is True:
            return experiment.budget
        if isinstance(value, dict):
            done = value.get(experiment.unit)
            return min(done, experiment.budget) if isinstance(done, int) else 0
    return 0
