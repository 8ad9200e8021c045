"""The command `aggregate`: one verdict over the comparisons of several environments."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from baselines import web_page
from baselines.curves import COLOURS, DARK, LIGHT, STYLES, Ground, dress, plain
from baselines.files import write_atomic
from baselines.head_to_head import interquartile_mean, pairs, performance_profile
from baselines.records import RecordError
from baselines.report import DASH, finished_runs, number, pair_table, print_table
from baselines.statistics import FEW
from baselines.study import load_study, read_runs, study_folders
from baselines.usage import usage_errors
from bnprl_envs import registry
from bnprl_envs.tables import FloatArray

if TYPE_CHECKING:
    from baselines.options import Aggregate

Scores = dict[str, dict[str, FloatArray]]
"""Contender -> environment -> (n,) score of each run, 0 as random and 1 as the best known."""

THRESHOLDS = np.linspace(-0.25, 1.1, 136)
MEANING = (
    "The interquartile mean leaves out the best and the worst quarter of the runs. Intervals are "
    f"the bootstrap's over runs within environments, too narrow where these are fewer than {FEW}; "
    "p-values are of two-sided permutation tests, corrected by Holm for the number of pairs."
)
NO_PAIRS = "Who beats whom takes two agents that have finished runs in every folder."
HEADER = ["agent", "interquartile mean", "95% interval", "mean", "runs"]


def aggregate(options: Aggregate) -> int:
    """Normalise, summarise and draw; return the exit code."""
    with usage_errors(RecordError, ValueError):
        scores = read_scores(options.folders)
        summary = summarise(scores)
        options.out.mkdir(parents=True, exist_ok=True)
        write_atomic(options.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        light, dark = draw_profiles(scores, LIGHT), draw_profiles(scores, DARK)
        write_atomic(options.out / "profiles.png", light)
        write_atomic(options.out / "report.html", page(summary, light, dark))
    print(caption(summary))
    print_table(table(summary))
    if summary["pairs"]:
        print_table(pair_table(summary["pairs"]))
    else:
        print(NO_PAIRS)
    print(f"performance profiles: {options.out / 'profiles.png'}")
    print(f"report: {options.out / 'report.html'}")
    return 0


def page(summary: Mapping[str, Any], light: bytes, dark: bytes) -> str:
    """Return the page (HTML) of a summary.

    Args:
        summary: of the scores.
        light: the performance profiles (PNG) on a light ground.
        dark: the same on a dark one.
    """
    pairs = pair_table(summary["pairs"])
    head_to_head = web_page.table("pairs", pairs) if len(pairs) > 1 else f"<p>{NO_PAIRS}</p>"
    body = f"""<p>{escape(caption(summary))}</p>
<p>{MEANING}</p>
{web_page.table("scores", table(summary))}
<h2>Head to head</h2>
{head_to_head}
<h2>Performance profiles</h2>
{web_page.picture(light, dark, "Share of runs above each score; the means are in the table")}"""
    return web_page.document(f"Agents over {_environments(summary['environments'])}", body)


def caption(summary: Mapping[str, Any]) -> str:
    """Return of what the scores are."""
    found = summary["environments"]
    return f"Scores (0 random, 1 best known) over {_environments(found)}: {', '.join(found)}."


def _environments(found: Sequence[str]) -> str:
    return f"{len(found)} environment{'s' * (len(found) > 1)}"


def read_scores(folders: Sequence[Path]) -> Scores:
    """Return the normalised final scores of the contenders that every folder has.

    Raises:
        RecordError: a folder holds no experiment.
        ValueError: there is no folder, an environment is there twice, or has no known random and
            best values, or no contender has finished runs in all of them.
    """
    if not folders:
        raise ValueError("give the folders of one comparison or more")
    found: dict[str, dict[str, FloatArray]] = {}
    for folder in (place for given in folders for place in study_folders(given)):
        study = load_study(folder)
        environment = study.experiment.environment.id
        if environment in found:
            raise ValueError(f"{folder}: {environment} is there twice")
        low, high = _ends(environment, study.experiment.environment.kwargs)
        runs = finished_runs(read_runs(study.experiment, folder))
        found[environment] = {
            name: (np.array([run[-1].return_mean for run in finished]) - low) / (high - low)
            for name, finished in runs.items()
            if finished
        }
    common = [n for n in next(iter(found.values())) if all(n in of for of in found.values())]
    if not common:
        raise ValueError("no agent has finished runs in every folder")
    return {name: {id: of[name] for id, of in found.items()} for name in common}


def _ends(id: str, kwargs: Mapping[str, Any]) -> tuple[float, float]:
    """Return the values of random play and the best known one."""
    known = {}
    if id in registry.environment_ids() and not kwargs:
        known = {r.name: r.value for r in registry.entry(id).references}
    if "random" not in known or "lower" not in known:
        raise ValueError(f"{id}: the values of random play and of the best policy are not known")
    return known["random"], known["lower"]


def summarise(scores: Scores) -> dict[str, Any]:
    """Return the rows, best interquartile mean first, and every pair, as JSON values."""
    rows = []
    for name, of in scores.items():
        interval = interquartile_mean(list(of.values()))
        rows.append(
            {
                "agent": name,
                "iqm": interval.mean,
                "ci_low": interval.low,
                "ci_high": interval.high,
                "mean": float(np.mean([values.mean() for values in of.values()])),
                "runs": sum(len(values) for values in of.values()),
            }
        )
    strata = {name: list(of.values()) for name, of in scores.items()}
    return {
        "environments": list(next(iter(scores.values()))),
        "rows": sorted(rows, key=lambda row: -float(row["iqm"])),
        "pairs": [dataclasses.asdict(pair) for pair in pairs(strata)],
    }


def table(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the cells of the table of scores, header first."""
    return [HEADER, *(_cells(row) for row in summary["rows"])]


def _cells(row: Mapping[str, Any]) -> list[str]:
    low, high = number(row["ci_low"], ".3f"), number(row["ci_high"], ".3f")
    return [
        row["agent"],
        number(row["iqm"], ".3f"),
        DASH if row["ci_low"] is None else f"{low} to {high}",
        number(row["mean"], ".3f"),
        number(row["runs"], ",d"),
    ]


def draw_profiles(scores: Scores, ground: Ground) -> bytes:
    """Return a picture (PNG) on some ground: share of runs above each score."""
    figure = Figure(figsize=(7.5, 4.6), facecolor=ground.paper, layout="constrained")
    axes = figure.subplots()
    for index, (name, of) in enumerate(scores.items()):
        profile = performance_profile(list(of.values()), THRESHOLDS)
        axes.plot(
            THRESHOLDS,
            profile,
            STYLES[index // 2 % len(STYLES)],
            color=COLOURS[index % len(COLOURS)],
            label=plain(name),
            linewidth=2,
        )
    axes.set(
        xlabel="normalised score s (0 random, 1 best known)",
        ylabel="share of runs above s",
    )
    over = _environments([*next(iter(scores.values()))])
    axes.set_title(f"Performance profiles over {over}", color=ground.ink)
    axes.legend(frameon=False, labelcolor=ground.ink)
    dress(axes, ground)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    return picture.getvalue()
