"""The command `evaluate`: learned policies, over fresh episodes and exactly."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from baselines.commands import environment_of
from baselines.environment import EnvironmentSpec
from baselines.evaluation import Evaluation, evaluate
from baselines.learners import load_policy
from baselines.report import DASH, number, print_table
from baselines.statistics import mean_interval
from baselines.study import load_study, read_runs, trusted_environment
from baselines.usage import usage_errors
from bnprl_agents.policy_files import PolicyFileError

if TYPE_CHECKING:
    from baselines.options import Evaluate

_log = logging.getLogger(__name__)


def evaluate_policies(options: Evaluate) -> int:
    """Evaluate the policies of a folder, or one policy file."""
    with usage_errors():
        if options.episodes < 1:
            raise ValueError(f"--episodes: {options.episodes}, must be at least 1")
        if options.seed < 0:
            raise ValueError(f"--seed: {options.seed}, must be at least 0")
        environment, policies = _find_policies(options)
        results: dict[str, list[Evaluation]] = {}
        damaged: list[str] = []
        for name, path in tqdm(policies, unit=" policies", disable=not options.progress, delay=1):
            try:
                policy = load_policy(path, options.agent)
            except PolicyFileError as error:
                if len(policies) == 1:
                    raise
                damaged.append(str(error))
                continue
            seed = np.random.SeedSequence([options.seed, len(results.get(name, []))])
            result = evaluate(policy, environment, episodes=options.episodes, seed=seed)
            results.setdefault(name, []).append(result)
    rows = [_evaluation_row(name, found, options) for name, found in results.items()]
    print(f"{environment.id}: mean discounted return")
    print_table([["policy", "mean", "95% interval", "over", "exact"], *rows])
    for reason in damaged:
        print(f"bnprl: error: {reason}", file=sys.stderr)
    return 1 if damaged else 0


def _find_policies(options: Evaluate) -> tuple[EnvironmentSpec, list[tuple[str, Path]]]:
    """Return the environment and (label, file) of each policy."""
    target = options.target
    if not target.exists():
        raise ValueError(f"{target}: no such file or folder")
    if target.is_file():
        load_policy(target, options.agent)  # what is wrong with the file is said first
        if options.env is not None:
            return environment_of(options.env), [(target.name, target)]
        folder = target.resolve().parent.parent.parent
        if not (folder / "experiment.json").is_file():
            raise ValueError(f"{target}: lies in no experiment's folder; name it with --env ID")
        return trusted_environment(load_study(folder)), [(target.name, target)]
    study = load_study(target)
    found = [
        (files, files.find_policy() if records.finished else None)
        for files, records in read_runs(study.experiment, target).items()
    ]
    policies = [(files.contender, path) for files, path in found if path is not None]
    missing = [files.name for files, path in found if path is None]
    if policies and missing:
        _log.warning(
            "no policy of a finished run of %s; the command that made the folder makes it",
            ", ".join(missing),
        )
    if not policies:
        raise ValueError(f"{target}: holds no policy of a finished run yet")
    environment = trusted_environment(study) if options.env is None else environment_of(options.env)
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
