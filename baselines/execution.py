"""Runs the seeds of every contender, in parallel, and goes on where an earlier command stopped."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm

from baselines.contenders import Learner, build_learner
from baselines.evaluation import evaluate
from baselines.experiment import Experiment
from baselines.records import Record, RunFiles, RunLog, open_log, parse_json
from bnprl_agents.training import Progress

ENGINES = ("joblib", "ray", "dask")
POLL_SECONDS = 0.5
"""Time between two looks at the records for the progress bar."""
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Runs are the unit of parallelism: each computes with one thread, in the same order always."""


@dataclass(frozen=True)
class Run:
    """One contender with one seed, to be run by whatever process.

    Attributes:
        experiment: what it belongs to.
        files: where its records go.
        tensorboard: folder for TensorBoard's logs, None for none.
        owner: process that asked for the run.
    """

    experiment: Experiment
    files: RunFiles
    tensorboard: Path | None
    owner: int


def execute(
    experiment: Experiment,
    folder: Path,
    *,
    jobs: int = 1,
    engine: str = "joblib",
    tensorboard: bool = False,
    progress: bool = True,
) -> list[RunFiles]:
    """Do every run that is not finished yet; one that fails does not stop the others.

    Args:
        experiment: what to run.
        folder: where its records are and go.
        jobs: runs at the same time.
        engine: "joblib" (processes here), or a "ray" or "dask" cluster.
        tensorboard: write TensorBoard's logs below the folder.
        progress: show a bar.

    Returns:
        The runs that failed; their tracebacks are in files beside their records.

    Raises:
        RecordError: the records of a run are damaged.
        ImportError: the engine is not installed.
    """
    logs = folder / "tensorboard" if tensorboard else None
    every = [
        RunFiles(folder, e.name, i) for e in experiment.entries for i in range(experiment.seeds)
    ]
    pending = [files for files in every if not files.read().finished]
    runs = [
        Run(experiment, files, logs, os.getpid()) for files in _longest_first(experiment, every)
    ]
    runs = [run for run in runs if run.files in pending]
    if not runs:
        return []
    with _engine(engine, jobs), _progress_bar(experiment, every, shown=progress):
        done = joblib.Parallel()(joblib.delayed(_attempt)(run) for run in runs)
    return [run.files for run, good in zip(runs, done, strict=True) if not good]


def _longest_first(experiment: Experiment, every: Sequence[RunFiles]) -> list[RunFiles]:
    """Order runs by the time that other seeds took; unknown: Stable-Baselines3's first."""
    known: dict[str, float] = {}
    for files in every:
        for record in files.read().lines[-1:]:
            share = getattr(record, experiment.unit) / experiment.budget
            estimate = (record.train_seconds + record.eval_seconds) / max(share, 1e-6)
            known[files.contender] = max(estimate, known.get(files.contender, 0.0))
    for entry in experiment.entries:
        known.setdefault(entry.name, math.inf if entry.learner.family == "sb3" else 0.0)
    return sorted(every, key=lambda files: -known[files.contender])


@contextlib.contextmanager
def _engine(engine: str, jobs: int) -> Iterator[None]:
    """Choose joblib's backend for the block."""
    if engine == "dask":
        from dask.distributed import Client

        with Client(n_workers=jobs, threads_per_worker=1), joblib.parallel_config("dask"):
            yield
    elif engine == "ray":
        from ray.util.joblib import register_ray

        register_ray()
        with joblib.parallel_config("ray", n_jobs=jobs):
            yield
    else:
        with joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
            yield


def _attempt(run: Run) -> bool:
    """Do a run in a worker; false if it failed."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
    if os.getpid() != run.owner and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the owner hears it and ends the workers
    try:
        run_one(run)
    except Exception:
        run.files.error.parent.mkdir(parents=True, exist_ok=True)
        run.files.error.write_text(traceback.format_exc())
        return False
    run.files.error.unlink(missing_ok=True)
    return True


def run_one(run: Run) -> None:
    """Build, train, evaluate and record one contender with one seed, unless that is done.

    The records appear line by line; the policy file is there before the last of them.
    """
    experiment, files = run.experiment, run.files
    entry = experiment.entry(files.contender)
    with open_log(files.records) as log:
        if files.read().finished:
            return
        log.restart()
        seed, _ = experiment.run_seeds(entry.name, files.seed)
        logs = run.tensorboard and run.tensorboard / entry.name / str(files.seed)
        learner = build_learner(
            entry.learner, experiment.environment, entry.build_settings(), seed, logs
        )
        _Course(run, learner, log).follow()


class _Course:
    """The way of one learner through its budget."""

    def __init__(self, run: Run, learner: Learner, log: RunLog) -> None:
        self._run = run
        self._learner = learner
        self._log = log
        self._train_seconds = 0.0
        self._eval_seconds = 0.0
        self._parent = os.getppid()
        points = run.experiment.eval_points
        _, sequence = run.experiment.run_seeds(run.files.contender, run.files.seed)
        self._seeds = [int(seed) for seed in sequence.generate_state(points)]

    def follow(self) -> None:
        """Train to the end of the budget, evaluating on the way."""
        experiment = self._run.experiment
        points, reached = experiment.eval_points, 0
        progress, metrics = Progress(0, 0), {}
        started = time.perf_counter()
        for progress in self._learner.learn(episodes=experiment.episodes, steps=experiment.steps):
            self._train_seconds += time.perf_counter() - started
            self._stop_if_orphaned()
            metrics = progress.metrics or metrics
            point = getattr(progress, experiment.unit) * points // experiment.budget
            if reached < point < points:
                reached = point
                self._measure(progress, metrics, point - 1)
            started = time.perf_counter()
        self._train_seconds += time.perf_counter() - started
        self._save()
        self._measure(progress, metrics, points - 1, final=True)

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
        )
        self._log.append(record)

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

    def _stop_if_orphaned(self) -> None:
        """End a worker whose owner was killed: the command may already be running again."""
        if self._parent == self._run.owner and os.getppid() != self._parent:
            os._exit(1)


def _finite(metrics: dict[str, Any]) -> dict[str, float]:
    """Leave out what JSON cannot hold."""
    numbers = {name: float(value) for name, value in metrics.items()}
    return {name: value for name, value in numbers.items() if np.isfinite(value)}


@contextlib.contextmanager
def _progress_bar(
    experiment: Experiment, every: Sequence[RunFiles], *, shown: bool
) -> Iterator[None]:
    """Follow all runs by their records while the block lasts."""
    if not shown:
        yield
        return
    ended = threading.Event()
    total = experiment.budget * len(every)
    with tqdm(total=total, unit=f" {experiment.unit}", unit_scale=True, smoothing=0.05) as bar:
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
    last = False
    while not last:
        last = ended.wait(POLL_SECONDS)
        for files in every:
            if finished.get(files) != experiment.budget:
                finished[files] = _done(experiment, files)
        runs = sum(done == experiment.budget for done in finished.values())
        bar.set_postfix_str(f"{runs}/{len(every)} runs", refresh=False)
        bar.n = sum(finished.values())
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
