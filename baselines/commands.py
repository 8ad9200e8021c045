"""What the commands do, once their arguments are parsed."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from baselines import reproduction
from baselines.contenders import (
    CONTENDERS,
    EXTRA_MODULES,
    MissingExtraError,
    build_learner,
)
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment, configured_entries
from baselines.records import FolderInUseError, RecordError, RunFiles, folder_lock
from baselines.report import finished_runs, print_table, table, write_report
from baselines.sb3_checks import check_served
from baselines.study import load_study, open_study, read_runs
from baselines.usage import usage_errors
from bnprl_agents.controllers.learner import NegativeRewardError
from bnprl_envs import registry

if TYPE_CHECKING:
    from baselines.cli import Compare, Train


_log = logging.getLogger(__name__)


def list_names(what: str) -> int:
    """Print the names of one kind with a line about each."""
    if what == "envs":
        rows = [(id, registry.entry(id).summary) for id in registry.environment_ids()]
    elif what == "agents":
        rows = [(name, contender.summary) for name, contender in CONTENDERS.items()]
    else:
        rows = [(n, reproduction.summary(path)) for n, path in reproduction.names().items()]
    if not rows:
        print(f"There are no {what} yet.")
    width = max((len(name) for name, _ in rows), default=0)
    for name, summary in rows:
        print(f"{name:<{width}}  {summary}")
    return 0


def train(options: Train, given: Sequence[str]) -> int:
    """Train one agent: an experiment of one run."""
    with usage_errors():
        entry = Entry.of(options.agent, getattr(options, "settings", None))
        experiment = Experiment(
            environment=environment_of(options.id),
            entries=(entry,),
            episodes=options.episodes,
            steps=options.steps,
            root_seed=options.seed,
            eval_episodes=options.eval_episodes,
            eval_points=options.eval_points,
        )
        if entry.learner.family == "sb3":
            check_sb3(experiment, entry)
        try_out(experiment, entry, "--reward-shift ")
    return conduct(
        experiment,
        options.out,
        given,
        jobs=1,
        tensorboard=options.tensorboard,
        progress=options.progress,
    )


def compare(options: Compare, given: Sequence[str]) -> int:
    """Compare agents."""
    with usage_errors():
        if options.jobs is not None and options.jobs < 1:
            raise ValueError(f"--jobs: {options.jobs}, must be at least 1")
        experiment = Experiment(
            environment=environment_of(options.id),
            entries=configured_entries(options.agents, options.set),
            episodes=options.episodes,
            steps=options.steps,
            seeds=options.seeds,
            root_seed=options.seed,
            eval_episodes=options.eval_episodes,
            eval_points=options.eval_points,
        )
        for entry in experiment.entries:
            if entry.learner.family == "sb3":
                check_sb3(experiment, entry)
            else:
                try_out(experiment, entry, f"--set {entry.name}.reward_shift=")
    return conduct(
        experiment,
        options.out,
        given,
        jobs=options.jobs,
        engine=options.engine,
        tensorboard=options.tensorboard,
        progress=options.progress,
    )


def environment_of(id: str) -> EnvironmentSpec:
    """Return an environment that exists and can be made.

    Raises:
        ValueError: there is none of this id (near misses are named), or its model is bad.
        OSError: the model file cannot be read.
    """
    environment = EnvironmentSpec(id)
    environment.try_out()
    return environment


def try_out(experiment: Experiment, entry: Entry, flag: str) -> None:
    """Build a learner once, so that what it cannot do is said before anything is written.

    Raises:
        ValueError: it cannot serve the environment; `flag` says how a setting is given.
    """
    learner = build_learner(entry.learner, experiment.environment, entry.build_settings(), seed=0)
    try:
        learner.learn(episodes=1)  # checks and returns an iterator, which alone would learn
    except NegativeRewardError as error:
        raise ValueError(
            f"{entry.name} on {experiment.environment.id}: {error}; give {flag}{error.shift:g}"
        ) from error


def check_sb3(experiment: Experiment, entry: Entry) -> None:
    """Check what Stable-Baselines3's learners need without importing them: that takes seconds.

    Raises:
        MissingExtraError: a package is not installed.
        ValueError: it cannot serve the environment, or the budget is smaller than one rollout.
    """
    settings = entry.build_settings()
    with contextlib.closing(experiment.environment.make_vec(1)) as env:
        try:
            check_served(settings, env)
        except ValueError as error:
            raise ValueError(f"{entry.name} on {experiment.environment.id}: {error}") from error
    rollout_steps = settings.rollout_steps
    if experiment.steps is not None and experiment.steps < rollout_steps:
        raise ValueError(
            f"--steps: {experiment.steps}, {entry.name} needs at least one rollout of "
            f"{rollout_steps}"
        )
    for module in EXTRA_MODULES:
        if importlib.util.find_spec(module) is None:
            raise MissingExtraError(f'{module} is not installed: pip install "bnprl[baselines]"')


def conduct(
    experiment: Experiment,
    folder: Path,
    given: Sequence[str],
    *,
    jobs: int | None = None,
    engine: str = "joblib",
    tensorboard: bool = False,
    progress: bool = True,
) -> int:
    """Run an experiment in its folder and report it; return the exit code."""
    import joblib

    from baselines.execution import execute

    with _locked(folder):
        with usage_errors():
            open_study(folder, experiment, shlex.join(["bnprl", *given]))
        with usage_errors(RecordError, MissingExtraError):
            failed = execute(
                experiment,
                folder,
                jobs=joblib.cpu_count() if jobs is None else jobs,
                engine=engine,
                tensorboard=tensorboard,
                progress=progress,
            )
        _report(folder)
        _name_idle(experiment, folder)
    return _name_failures(failed)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        with usage_errors(FolderInUseError):
            stack.enter_context(folder_lock(folder))
        yield


def _name_failures(failed: Sequence[RunFiles]) -> int:
    if not failed:
        return 0
    names = ", ".join(files.name for files in failed)
    reason = failed[0].error.read_text().strip().splitlines()[-1]
    print(
        f"bnprl: error: failed: {names} ({reason}); traceback in {failed[0].error}; "
        "the same command tries again",
        file=sys.stderr,
    )
    return 1


def _name_idle(experiment: Experiment, folder: Path) -> None:
    """Warn of contenders for which the budget held no whole episode or update."""
    for name, runs in finished_runs(read_runs(experiment, folder)).items():
        idle = sum(not run[-1].metrics for run in runs)
        if idle:
            _log.warning(
                "%s learned nothing in %d of %d runs: no whole episode fits in a budget of %s %s",
                name,
                idle,
                len(runs),
                f"{experiment.budget:,}",
                experiment.unit,
            )


def report(folder: Path) -> int:
    """Make the report of a folder again."""
    with usage_errors():
        load_study(folder)
    with _locked(folder):
        _report(folder)
    return 0


def _report(folder: Path) -> None:
    with usage_errors(RecordError):
        summary = write_report(folder)
    print_table(table(summary))
    print(f"report: {folder / 'report.html'}")
        written = write_report(folder)
    print_table(table(written))
    print(f"report: {folder / 'report.html'}")


def evaluate_policies(options: Evaluate) -> int:
    """Evaluate the policies of a folder, or one policy file."""
    with usage_errors():
        if options.episodes < 1:
            raise ValueError(f"--episodes: {options.episodes}, must be at least 1")
        if options.seed < 0:
            raise ValueError(f"--seed: {options.seed}, must be at least 0")
        environment, policies = _find_policies(options)
        results: dict[str, list[Evaluation]] = {}
        for name, path in tqdm(policies, unit=" policies", disable=not options.progress, delay=1):
            policy = load_policy(path)
            seed = np.random.SeedSequence([options.seed, len(results.get(name, []))])
            result = evaluate(policy, environment, episodes=options.episodes, seed=seed)
            results.setdefault(name, []).append(result)
    rows = [_evaluation_row(name, found, options) for name, found in results.items()]
    print(f"{environment.id}: mean discounted return")
    print_table([["policy", "mean", "95% interval", "over", "exact"], *rows])
    return 0


def _find_policies(options: Evaluate) -> tuple[EnvironmentSpec, list[tuple[str, Path]]]:
    """Return the environment and (label, file) of each policy."""
    target = options.target
    if not target.exists():
        raise ValueError(f"{target}: no such file or folder")
    if target.is_file():
        load_policy(target)  # what is wrong with the file is said first
        if options.env is not None:
            return _environment(options.env), [(target.name, target)]
        folder = target.resolve().parent.parent.parent
        if not (folder / "experiment.json").is_file():
            raise ValueError(f"{target}: lies in no experiment's folder; name it with --env ID")
        return load_study(folder).experiment.environment, [(target.name, target)]
    experiment = load_study(target).experiment
    runs = (
        RunFiles(target, entry.name, index)
        for entry in experiment.entries
        for index in range(experiment.seeds)
    )
    found = [(files.contender, files.find_policy()) for files in runs]
    policies = [(name, path) for name, path in found if path is not None]
    if not policies:
        raise ValueError(f"{target}: holds no policy yet")
    environment = experiment.environment if options.env is None else _environment(options.env)
    return environment, policies


def _evaluation_row(name: str, results: Sequence[Evaluation], options: Evaluate) -> list[str]:
    """Return the cells of one contender: over its seeds, or one policy over episodes."""
    if len(results) == 1:
        values, over = results[0].returns, f"{options.episodes:,} episodes"
    else:
        values, over = np.array([r.returns.mean() for r in results]), f"{len(results)} seeds"
    interval = mean_interval(values, seed=options.seed)
    exact = [result.exact for result in results if result.exact is not None]
    low, high = number(interval.low, ".4f"), number(interval.high, ".4f")
    return [
        name,
        number(interval.mean, ".4f"),
        DASH if interval.low is None else f"{low} to {high}",
        over,
        number(sum(exact) / len(exact) if exact else None, ".4f"),
    ]


def print_table(rows: Iterable[Sequence[str]]) -> None:
    """Print cells in columns, numbers to the right."""
    rows = list(rows)
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        first, *others = (
            cell.ljust(width) if index == 0 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        print("  ".join([first, *others]).rstrip())
