"""Tables, curves and the page of an experiment, made again from its records at any time."""

from __future__ import annotations

import dataclasses
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from baselines.environment import EnvironmentSpec
from baselines.experiment import METRIC, Experiment
from baselines.files import write_atomic
from baselines.head_to_head import Pair, pairs
from baselines.records import Record, Records, RunFiles
from baselines.statistics import CONFIDENCE, FEW, mean_interval
from baselines.study import load_study, read_runs
from bnprl_envs import registry

REFERENCE_NAMES = {
    "random": "random",
    "memoryless": "best memoryless",
    "lower": "best known",
    "upper": "upper bound",
    "dissertation": "dissertation",
}
"""What the tables call the registry's references."""
DASH = "–"

PAIR_HEADER = ["better", "than", "difference", "P(better)", "p (Holm)"]

Row = dict[str, Any]
Curves = dict[str, list[tuple[Record, ...]]]
"""Contender -> the records of each of its finished runs, in the order of their seeds."""


def write_report(folder: Path) -> dict[str, Any]:
    """Write summary.json, summary.md, curves.png and report.html; return the summary.

    Raises:
        RecordError: the folder holds no experiment, or its files are damaged.
        OSError: the folder cannot be written.
    """
    from baselines.curves import DARK, LIGHT, draw_curves  # imports matplotlib
    from baselines.report_page import page

    study = load_study(folder)
    runs = read_runs(study.experiment, folder)
    curves = finished_runs(runs)
    summary = summarise(study.experiment, runs)
    write_atomic(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    write_atomic(folder / "summary.md", markdown(summary))
    references = [row for row in summary["rows"] if row["reference"]]
    light = draw_curves(study.experiment, curves, references, LIGHT)
    dark = draw_curves(study.experiment, curves, references, DARK)
    write_atomic(folder / "curves.png", light)
    write_atomic(folder / "report.html", page(study, summary, light, dark))
    return summary


def finished_runs(runs: Mapping[RunFiles, Records]) -> Curves:
    """Return the records of the finished runs by contender; every contender has a list."""
    curves: Curves = {}
    for files, records in runs.items():
        of_contender = curves.setdefault(files.contender, [])
        if records.finished:
            of_contender.append(records.lines)
    return curves


def summarise(experiment: Experiment, runs: Mapping[RunFiles, Records]) -> dict[str, Any]:
    """Return the table as JSON values: contenders in their order, then reference values.

    Each run counts once, by the mean discounted return of its final evaluation; intervals are
    over seeds. `steps`, `episodes` and `train_seconds` are means over seeds.
    """
    rows = [
        _row(name, [lines[-1] for lines in finished], experiment.root_seed)
        for name, finished in finished_runs(runs).items()
    ]
    return {
        "env": experiment.environment.id,
        "env_kwargs": experiment.environment.kwargs,
        "metric": METRIC,
        "confidence": CONFIDENCE,
        "budget": {experiment.unit: experiment.budget},
        "eval_episodes": experiment.eval_episodes,
        "unfinished_runs": sum(not records.finished for records in runs.values()),
        "failed_runs": failures(runs),
        "rows": rows + reference_rows(experiment.environment),
        "pairs": [dataclasses.asdict(pair) for pair in pairs(_finals(runs), experiment.root_seed)],
    }


def failures(runs: Mapping[RunFiles, Records]) -> dict[str, str]:
    """Return the runs that failed, each with the last line of its traceback."""
    return {
        files.name: files.failure()
        for files, records in runs.items()
        if not records.finished and files.error.exists()
    }


def name_failures(failed: Mapping[str, str]) -> str:
    """Return the names of runs that failed, and why the first of them did."""
    return f"failed: {', '.join(failed)} ({next(iter(failed.values()))})"


def _finals(runs: Mapping[RunFiles, Records]) -> dict[str, list[npt.NDArray[np.float64]]]:
    """Return the final values of the contenders that have any, as one environment's."""
    return {
        name: [np.array([lines[-1].return_mean for lines in finished])]
        for name, finished in finished_runs(runs).items()
        if finished
    }


def _row(name: str, finals: Sequence[Record], root_seed: int = 0) -> Row:
    seed = zlib.crc32(f"{root_seed} {name}".encode())
    return {
        "agent": name,
        **_interval("mean", "", [final.return_mean for final in finals], seed),
        **_interval("exact", "exact_", [final.exact_value for final in finals], seed),
        "seeds": len(finals),
        "steps": _mean([final.steps for final in finals]),
        "episodes": _mean([final.episodes for final in finals]),
        "train_seconds": _mean([final.train_seconds for final in finals]),
        "reference": False,
    }


def _interval(name: str, prefix: str, values: Sequence[float | None], seed: int) -> Row:
    """Return the three cells of a quantity; empty unless every run has a value."""
    known = [value for value in values if value is not None]
    keys = (name, f"{prefix}ci_low", f"{prefix}ci_high")
    if not known or len(known) < len(values):
        return dict.fromkeys(keys)
    interval = mean_interval(known, seed=seed)
    return dict(zip(keys, (interval.mean, interval.low, interval.high), strict=True))


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def reference_rows(environment: EnvironmentSpec) -> list[Row]:
    """Return what the registry knows of an environment; nothing of its variants."""
    if environment.kwargs or environment.id not in registry.environment_ids():
        return []
    return [
        _row(REFERENCE_NAMES.get(reference.name, reference.name), ())
        | {
            "mean": reference.value,
            "source": reference.source,
            "reference": True,
        }
        for reference in registry.entry(environment.id).references
    ]


def markdown(summary: Mapping[str, Any]) -> str:
    """Return the summary as a table of Markdown."""
    cells = markdown_table(table(summary))
    return "\n".join([f"# {summary['env']}", "", caption(summary), "", cells, ""])


def caption(summary: Mapping[str, Any]) -> str:
    """Return in a sentence or two what the numbers are."""
    (unit, budget), *_ = summary["budget"].items()
    text = (
        f"{summary['metric'].capitalize()} after training with a budget of {budget:,} {unit}; the "
        "table shows how much of it each agent used, in whole episodes or updates. Means over "
        f"seeds of {summary['eval_episodes']:,} evaluation episodes each, with "
        f"{summary['confidence']:.0%} intervals over seeds, Student's where they are fewer than "
        f"{FEW}, else the bootstrap's. The exact value is that of the learned policies over an "
        "infinite horizon, computed from the model."
    )
    if summary["unfinished_runs"]:
        failed = summary["failed_runs"]
        why = f"; {name_failures(failed)}" if failed else ""
        text += f" Runs that are not finished: {summary['unfinished_runs']}{why}."
    return text


def table(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the cells of the table, header first, as people read them."""
    level = f"{summary['confidence']:.0%} interval"
    header = [
        "agent",
        "mean",
        level,
        "exact",
        "seeds",
        "steps used",
        "episodes used",
        "train seconds",
    ]
    return [header, *(_cells(row) for row in summary["rows"])]


def _cells(row: Row) -> list[str]:
    name = f"{row['agent']} (reference)" if row["reference"] else row["agent"]
    low, high = number(row["ci_low"], ".3f"), number(row["ci_high"], ".3f")
    return [
        name,
        number(row["mean"], ".3f"),
        DASH if row["ci_low"] is None else f"{low} to {high}",
        number(row["exact"], ".3f"),
        number(row["seeds"] or None, ",.0f"),
        number(row["steps"], ",.0f"),
        number(row["episodes"], ",.0f"),
        number(row["train_seconds"], ",.1f"),
    ]


def pair_table(found: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the cells of a table of pairs, header first."""
    rows = [Pair(**values) for values in found]
    return [
        PAIR_HEADER,
        *(
            [
                row.first,
                row.second,
                number(row.difference, ".3f"),
                number(row.improvement, ".2f"),
                number(row.p_value, ".2g"),
            ]
            for row in rows
        ),
    ]


def number(value: float | None, form: str) -> str:
    """Return a number as text, a dash for none."""
    return DASH if value is None else format(value, form).replace("-", "−")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print cells in columns, of which the first is aligned to the left."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        first, *others = (
            cell.ljust(width) if index == 0 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        print("  ".join([first, *others]).rstrip())


def markdown_table(rows: Iterable[Sequence[str]], *, numbers: bool = True) -> str:
    """Return cells, header first, as a table of Markdown.

    Args:
        rows: of cells.
        numbers: all columns but the first are aligned to the right.
    """
    header, *body = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    rule = [":---", *["---:" if numbers else ":---"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *body))
