"""Runs the seeds of every contender, in parallel, and goes on where an earlier command stopped."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import signal
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.evaluation import evaluate
from baselines.experiment import Experiment
from baselines.learners import Learner, build_learner
from baselines.progress_bar import POLL_SECONDS, note, progress_bar
from baselines.records import Record, Records, RunFiles, RunLog, open_log
from baselines.study import read_runs
from baselines.tensorboard import Write, scalar_writer
from baselines.workers import Workers
from bnprl_agents.training import Progress

OWNER_SECONDS = 0.2
"""Time between two looks of a worker at whether its owner lives."""
WARM_UP_STEPS = 4096
"""Enough for a first update of the learners that compile much: 256 steps in each of 16 copies."""


@dataclass(frozen=True)
class Run:
    """One contender with one seed, to be run by whatever process.

    Attributes:
        experiment: what it belongs to.
        files: where its records go.
        tensorboard: folder for TensorBoard's logs, None for none.
        owner: process that asked for the run and without which it must end; None on a cluster.
    """

    experiment: Experiment
    files: RunFiles
    tensorboard: Path | None
    owner: int | None


def execute(
    experiment: Experiment,
    folder: Path,
    workers: Workers,
    *,
    tensorboard: bool = False,
    progress: bool = True,
) -> list[RunFiles]:
    """Do every run that is not finished yet; one that fails does not stop the others.

    Args:
        experiment: what to run.
        folder: where its records are and go.
        workers: what the runs are spread over; all of them see the folder.
        tensorboard: write TensorBoard's logs below the folder.
        progress: show a bar.

    Returns:
        The runs that failed; their tracebacks are in files beside their records.

    Raises:
        RecordError: the records of a run are damaged.
        EngineError, MissingExtraError: as `Workers.map`.
    """
    owner: int | None = os.getpid()
    if workers.engine != "joblib":  # elsewhere, maybe, and started in another folder
        owner, folder = None, folder.resolve()
    logs = folder / "tensorboard" if tensorboard else None
    found = read_runs(experiment, folder, repair=True)
    every = [Run(experiment, files, logs, owner) for files in _longest_first(experiment, found)]
    runs = [run for run in every if not _finished(run)]
    if not runs:
        return []
    for files in found:  # a killed command's notes
        files.progress.unlink(missing_ok=True)
    with progress_bar(experiment, tuple(found), shown=progress):
        done = workers.map(_attempt, runs, _finished)
    return [run.files for run, good in zip(runs, done, strict=True) if good is False]


def _finished(run: Run) -> bool:
    return run.files.read().finished and run.files.find_policy() is not None


def _longest_first(experiment: Experiment, found: Mapping[RunFiles, Records]) -> list[RunFiles]:
    """Order runs by the time that other seeds took; unknown: Stable-Baselines3's first."""
    known: dict[str, float] = {}
    for files, records in found.items():
        for record in records.lines[-1:]:
            share = getattr(record, experiment.unit) / experiment.budget
            estimate = (record.train_seconds + record.eval_seconds) / max(share, 1e-6)
            known[files.contender] = max(estimate, known.get(files.contender, 0.0))
    for entry in experiment.entries:
        known.setdefault(entry.name, math.inf if entry.learner.family == "sb3" else 0.0)
    return sorted(found, key=lambda files: -known[files.contender])


def _attempt(run: Run) -> bool:
    """Do a run in a worker; false if it failed."""
    if run.owner is not None and os.getpid() != run.owner:
        _serve(run.owner)
    try:
        run_one(run)
    except Exception:
        with contextlib.suppress(OSError):  # a full disk may be what failed
            run.files.error.parent.mkdir(parents=True, exist_ok=True)
            run.files.error.write_text(traceback.format_exc())
        return False
    run.files.error.unlink(missing_ok=True)
    return True


@functools.cache
def _serve(owner: int) -> None:
    """Make this process a worker that leaves interrupts to its owner and ends when that dies.

    Else the workers of a killed command would go on beside those of the next.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == owner:
            time.sleep(OWNER_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def run_one(run: Run) -> None:
    """Build, train, evaluate and record one contender with one seed, unless that is done.

    The records appear line by line; the policy file is there before the last of them.
    """
    experiment, files = run.experiment, run.files
    entry = experiment.entry(files.contender)
    with open_log(files.records) as log:
        if _finished(run):
            return
        log.restart()
        seed, _ = experiment.run_seeds(entry.name, files.seed)
        logs = run.tensorboard and run.tensorboard / entry.name / str(files.seed)
        build = functools.partial(
            build_learner, entry.learner, experiment.environment, entry.build_settings(), seed
        )
        if entry.learner.family != "sb3":
            _warm_up(build(), min(WARM_UP_STEPS, experiment.steps or WARM_UP_STEPS))
        with scalar_writer(logs) as board:
            try:
                _Course(run, build(logs), log, board).follow()
            finally:
                files.progress.unlink(missing_ok=True)


def _warm_up(learner: Learner, steps: int) -> None:
    """Let a learner to be thrown away compile, so that the seconds measured are of learning.

    It compiles until its first update, which may not come within so many steps.
    """
    any(progress.metrics for progress in learner.learn(steps=steps))


class _Course:
    """The way of one learner through its budget."""

    def __init__(self, run: Run, learner: Learner, log: RunLog, board: Write) -> None:
        self._run = run
        self._learner = learner
        self._log = log
        self._board = board
        self._train_seconds = 0.0
        self._eval_seconds = 0.0
        self._noted = -math.inf
        points = run.experiment.eval_points
        _, sequence = run.experiment.run_seeds(run.files.contender, run.files.seed)
        self._seeds = [int(seed) for seed in sequence.generate_state(points)]

    def follow(self) -> None:
        """Train to the end of the budget, evaluating on the way."""
        experiment = self._run.experiment
        points, reached = experiment.eval_points, 0
        progress = Progress(0, 0)
        metrics: dict[str, float] = {}
        started = time.perf_counter()
        for progress in self._learner.learn(episodes=experiment.episodes, steps=experiment.steps):
            self._train_seconds += time.perf_counter() - started
            self._note(progress)
            metrics = progress.metrics or metrics
            if self._run.experiment.entry(self._run.files.contender).learner.family != "sb3":
                self._board("training", _finite(progress.metrics), progress.steps)
            point = getattr(progress, experiment.unit) * points // experiment.budget
            if reached < point < points:
                reached = point
                self._measure(progress, metrics, point - 1)
            started = time.perf_counter()
        self._train_seconds += time.perf_counter() - started
        self._save()
        self._measure(progress, metrics, points - 1, final=True)

    def _note(self, progress: Progress) -> None:
        """Tell the progress bar how far the run is, if it was told long enough ago."""
        if time.monotonic() - self._noted >= POLL_SECONDS:
            note(self._run.files, int(getattr(progress, self._run.experiment.unit)))
            self._noted = time.monotonic()

    def _measure(
        self, progress: Progress, metrics: dict[str, float], point: int, final: bool = False
    ) -> None:
        experiment, files = self._run.experiment, self._run.files
        started = time.perf_counter()
        result = evaluate(
            self._learner.policy,
            experiment.environment,
            episodes=experiment.eval_episodes,
            seed=self._seeds[point],
        )
        self._eval_seconds += time.perf_counter() - started
        record = Record(
            contender=files.contender,
            seed=files.seed,
            episodes=int(progress.episodes),
            steps=int(progress.steps),
            train_seconds=self._train_seconds,
            eval_seconds=self._eval_seconds,
            return_mean=float(result.returns.mean()),
            return_std=float(result.returns.std()),
            length_mean=float(result.lengths.mean()),
            eval_episodes=len(result.returns),
            exact_value=None if result.exact is None else float(result.exact),
            metrics=_finite(metrics),
            final=final,
            reward_mean=float(result.rewards.mean()),
            train_reward=progress.reward,
            train_return=progress.returned,
        )
        self._log.append(record)
        scores = {"return_mean": record.return_mean, "length_mean": record.length_mean}
        self._board("evaluation", scores, record.steps)

    def _save(self) -> None:
        """Write the policy file, which appears by rename."""
        suffix = self._learner.policy_suffix
        target = self._run.files.policy(suffix)
        partial = target.with_name(f".{target.stem}.{os.getpid()}.partial{suffix}")
        try:
            self._learner.save(partial)
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)


def _finite(metrics: dict[str, Any]) -> dict[str, float]:
    """Leave out what JSON cannot hold."""
    numbers = {name: float(value) for name, value in metrics.items()}
    return {name: value for name, value in numbers.items() if np.isfinite(value)}
