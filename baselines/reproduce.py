"""The command `reproduce`: every panel in a folder of its own, then one summary and one figure."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.commands import check_sb3, conduct, try_out
from baselines.experiment import Experiment
from baselines.records import Record, write_atomic
from baselines.report import DASH, finished_runs, number, print_table, reference_rows
from baselines.reproduction import Comparison, Computation, Lines, Measure, Reproduction, find
from baselines.statistics import mean_interval
from baselines.study import read_runs
from baselines.usage import usage_errors

if TYPE_CHECKING:
    from baselines.cli import Reproduce

Row = dict[str, Any]


def reproduce(options: Reproduce, given: Sequence[str]) -> int:
    """Run what is not finished yet and report everything; return the exit code."""
    with usage_errors():
        reproduction = find(options.name)
        folder = options.out or Path("results") / (options.name + "-quick" * options.quick)
        for panel in reproduction.panels:
            if isinstance(panel, Comparison):
                _check(panel.sized(options.quick))
    failed = 0
    for panel in reproduction.panels:
        if isinstance(panel, Comparison):
            print(f"== {panel.title}", flush=True)
            failed |= conduct(
                panel.sized(options.quick),
                folder / panel.name,
                given,
                jobs=options.jobs,
                engine=options.engine,
                progress=options.progress,
            )
    folder.mkdir(parents=True, exist_ok=True)
    write(options.name, reproduction, folder, options.quick)
    return failed


def _check(experiment: Experiment) -> None:
    for entry in experiment.entries:
        if entry.learner.family == "sb3":
            check_sb3(experiment, entry)
        else:
            try_out(experiment, entry, "the setting reward_shift=")


def write(name: str, reproduction: Reproduction, folder: Path, quick: bool) -> None:
    """Write summary.json, summary.md and figure.png, and print the tables.

    Raises:
        RecordError: records are damaged.
        OSError: the folder cannot be written.
    """
    from baselines.figures import draw  # imports matplotlib

    lines = [panel_lines(panel, folder, quick) for panel in reproduction.panels]
    tables: list[dict[str, Any]] = [
        {"name": panel.name, "title": panel.title, "measure": _label(panel), "rows": rows}
        for panel, found in zip(reproduction.panels, lines, strict=True)
        for rows in [panel_rows(panel, found, quick)]
    ]
    values = {"experiment": name, "title": reproduction.title, "quick": quick, "panels": tables}
    write_atomic(folder / "summary.json", json.dumps(values, indent=2, allow_nan=False) + "\n")
    write_atomic(folder / "summary.md", markdown(reproduction, tables, quick))
    write_atomic(folder / "figure.png", draw(reproduction, lines))
    for panel in tables:
        print(f"== {panel['title']}: {panel['measure']}")
        print_table(cells(panel["rows"]))
    print(f"figure: {folder / 'figure.png'}")


def panel_lines(panel: Comparison | Computation, folder: Path, quick: bool) -> Lines:
    """Return what a panel draws: the measure of each contender's runs, or what is computed."""
    if isinstance(panel, Computation):
        return panel.compute(quick)
    runs = finished_runs(read_runs(panel.sized(quick), folder / panel.name))
    found = {name: _curves(finished, panel.measure) for name, finished in runs.items() if finished}
    return {name: curve for name, curve in found.items() if curve is not None}


def _curves(runs: Sequence[Sequence[Record]], measure: Measure) -> Any:
    """Return steps (points,) and the measure (runs, points), on one grid."""
    from baselines.curves import newest, on_one_grid

    known = [newest([r for r in run if measure.of(r) is not None]) for run in runs]
    if not all(known):
        return None
    return on_one_grid(known, "steps", lambda record: measure.of(record) or 0.0)


def panel_rows(panel: Comparison | Computation, lines: Lines, quick: bool) -> list[Row]:
    """Return the rows of a panel's table: the last values, then references."""
    rows = [_row(label, y[:, -1]) for label, (_, y) in lines.items()]
    rows += [
        _row(reference.name, np.array([reference.value])) | {"source": reference.source}
        for reference in panel.references
    ]
    if isinstance(panel, Comparison) and panel.measure.label.endswith("discounted return"):
        known = reference_rows(panel.sized(quick).environment)
        rows += [
            _row(row["agent"], np.array([row["mean"]])) | {"source": row["source"]} for row in known
        ]
    return rows


def _row(label: str, values: Any) -> Row:
    interval = mean_interval(values, seed=zlib.crc32(label.encode()))
    return {
        "agent": label,
        "mean": interval.mean,
        "ci_low": interval.low,
        "ci_high": interval.high,
        "median": float(np.median(values)),
        "seeds": len(values),
        "source": None,
    }


def cells(rows: Sequence[Row]) -> list[list[str]]:
    """Return the cells of a table, header first, as people read them."""
    header = ["agent", "mean", "95% interval", "median", "seeds"]
    return [header, *(_cells(row) for row in rows)]


def _cells(row: Row) -> list[str]:
    low, high = number(row["ci_low"], ".4g"), number(row["ci_high"], ".4g")
    reference = row["source"] is not None
    return [
        f"{row['agent']} (reference)" if reference else row["agent"],
        number(row["mean"], ".4g"),
        DASH if row["ci_low"] is None else f"{low} to {high}",
        DASH if reference else number(row["median"], ".4g"),
        DASH if reference else number(row["seeds"], ",.0f"),
    ]


def markdown(reproduction: Reproduction, tables: Sequence[Mapping[str, Any]], quick: bool) -> str:
    """Return the whole as Markdown."""
    size = " (quick size: far fewer seeds and steps)" if quick else ""
    text = [f"# {reproduction.title}{size}", "", "![figure](figure.png)", ""]
    for panel in tables:
        header, *body = cells(panel["rows"])
        numbers = "|".join([" :--- ", *[" ---: "] * (len(header) - 1)])
        lines = [f"| {' | '.join(line)} |" for line in (header, *body)]
        lines.insert(1, f"|{numbers}|")
        text += [f"## {panel['title']}: {panel['measure']}", "", *lines, ""]
    return "\n".join([*text, *(f"{note}\n" for note in reproduction.notes)])


def _label(panel: Comparison | Computation) -> str:
    return panel.measure.label if isinstance(panel, Comparison) else panel.y
