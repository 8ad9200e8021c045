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

from baselines import reproduction
from baselines.contenders import CONTENDERS, EXTRA_MODULES, MissingExtraError
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment, configured_entries
from baselines.files import FolderInUseError, folder_lock
from baselines.learners import AgentLearner, build_learner
from baselines.records import RecordError, RunFiles
from baselines.report import (
    finished_runs,
    name_failures,
    print_table,
    table,
    write_report,
)
from baselines.sb3_checks import check_served
from baselines.study import is_reproduction, load_study, open_study, read_runs, study_folders
from baselines.usage import usage_errors
from baselines.workers import EngineError, Workers
from bnprl_agents.controllers.learner import NegativeRewardError
from bnprl_envs import registry

if TYPE_CHECKING:
    from baselines.options import Compare, ListNames, Report, Reproduce, Train


_log = logging.getLogger(__name__)


def list_names(options: ListNames) -> int:
    """Print the names of one kind with a line about each."""
    what = options.what
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
        Workers(),
        tensorboard=options.tensorboard,
        progress=options.progress,
    )


def compare(options: Compare, given: Sequence[str]) -> int:
    """Compare agents."""
    with usage_errors():
        workers = workers_of(options)
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
        workers,
        tensorboard=options.tensorboard,
        progress=options.progress,
    )


def workers_of(options: Compare | Reproduce) -> Workers:
    """Return what the options spread runs over: as many processes as cores if not given.

    Raises:
        ValueError: as `Workers`.
    """
    import joblib

    jobs = joblib.cpu_count() if options.jobs is None else options.jobs
    return Workers(jobs, options.engine, options.address)


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
    workers: Workers,
    *,
    tensorboard: bool = False,
    progress: bool = True,
) -> int:
    """Run an experiment in its folder and report it; return the exit code."""
    from baselines.execution import execute

    with _locked(folder):
        with usage_errors():
            open_study(folder, experiment, shlex.join(["bnprl", *given]))
        with usage_errors(RecordError, MissingExtraError, EngineError):
            failed = execute(
                experiment,
                folder,
                workers,
                tensorboard=tensorboard,
                progress=progress,
            )
        code = _print_failures(failed)
        _name_idle(experiment, folder)
        _report(folder)
    return code


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        with usage_errors(FolderInUseError):
            stack.enter_context(folder_lock(folder))
        yield


def _print_failures(failed: Sequence[RunFiles]) -> int:
    if not failed:
        return 0
    reasons = {files.name: files.failure() for files in failed}
    print(
        f"bnprl: error: {name_failures(reasons)}; traceback in {failed[0].error}; "
        "the same command tries again",
        file=sys.stderr,
    )
    return 1


def _name_idle(experiment: Experiment, folder: Path) -> None:
    """Warn of contenders for which the budget held no update, and say which one would."""
    for name, runs in finished_runs(read_runs(experiment, folder)).items():
        idle = sum(not run[-1].metrics for run in runs)
        if idle:
            _log.warning(
                "%s learned nothing in %d of %d runs: no update fits in a budget of %s %s%s",
                name,
                idle,
                len(runs),
                f"{experiment.budget:,}",
                experiment.unit,
                _enough(experiment, experiment.entry(name)),
            )


def _enough(experiment: Experiment, entry: Entry) -> str:
    """Return words on a budget in which an update fits, none where nobody knows it."""
    learner = build_learner(entry.learner, experiment.environment, entry.build_settings(), seed=0)
    horizon = experiment.environment.horizon if experiment.steps is not None else 1
    if not isinstance(learner, AgentLearner) or horizon is None:
        return ""
    return f"; {horizon * learner.first_update_episodes():,} are enough"


def report(options: Report) -> int:
    """Make the report of a folder again; of a reproduction those of its panels, and its own."""
    reproduced = is_reproduction(options.folder)
    with usage_errors():
        folders = study_folders(options.folder, required=not reproduced)
        for place in folders:
            load_study(place)
    for place in folders:
        with _locked(place):
            _report(place)
    if reproduced:
        from baselines.reproduce import write_again  # imports this module

        with usage_errors(ValueError):
            write_again(options.folder)
    return 0


def _report(folder: Path) -> None:
    with usage_errors(RecordError):
        summary = write_report(folder)
    print_table(table(summary))
    print(f"report: {folder / 'report.html'}")
