"""The command `reproduce`: every panel in a folder of its own, then one summary and one figure."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from baselines.commands import check_sb3, conduct, try_out, workers_of
from baselines.experiment import Experiment
from baselines.files import parse_json, write_atomic
from baselines.records import Record, RecordError
from baselines.report import (
    failures,
    finished_runs,
    print_table,
    reference_rows,
)
from baselines.reproduction import (
    Comparison,
    Computation,
    Lines,
    Measure,
    Reproduction,
    find,
    names,
)
from baselines.reproduction_tables import cells, markdown, side_by_side
from baselines.statistics import mean_interval
from baselines.study import read_runs
from baselines.usage import UsageError, usage_errors

if TYPE_CHECKING:
    from baselines.options import Reproduce

Row = dict[str, Any]


def reproduce(options: Reproduce, given: Sequence[str]) -> int:
    """Run what is not finished yet of one experiment or of all; return the exit code."""
    if options.all == (options.name is not None):
        raise UsageError("give the name of an experiment, or --all")
    suffix = "-quick" * options.quick
    if options.name is not None:
        folder = options.out or Path("results") / (options.name + suffix)
        return _reproduce(options.name, folder, options, given)
    root = options.out or Path("results") / f"all{suffix}"
    failed = 0
    for name in names():
        failed |= _reproduce(name, root / name, options, given)
    write_page("Tables and figures of the source", root, [root / name for name in names()])
    return failed


def _reproduce(name: str, folder: Path, options: Reproduce, given: Sequence[str]) -> int:
    with usage_errors():
        workers = workers_of(options)
        reproduction = find(name)
        for panel in reproduction.panels:
            for experiment in _experiments(panel, options.quick).values():
                _check(experiment)
    failed, conducted = 0, []
    for panel in reproduction.panels:
        for place, experiment in _experiments(panel, options.quick).items():
            if (place, experiment) in conducted:  # another view of the same runs
                continue
            conducted.append((place, experiment))
            print(f"== {panel.title}", flush=True)
            failed |= conduct(
                experiment,
                folder / place,
                given,
                workers,
                progress=options.progress,
            )
    folder.mkdir(parents=True, exist_ok=True)
    write(name, reproduction, folder, options.quick)
    write_page(reproduction.title, folder, [folder])
    return failed


def write_page(title: str, folder: Path, of: Sequence[Path]) -> None:
    """Write report.html about the reproductions in folders."""
    from baselines.reproduction_page import page

    summaries = {place: json.loads((place / "summary.json").read_bytes()) for place in of}
    write_atomic(folder / "report.html", page(title, summaries))
    print(f"report: {folder / 'report.html'}")


def write_again(folder: Path) -> None:
    """Write the summary, the figure and the page of a reproduction again, from its records.

    Raises:
        RecordError: its summary or its records are damaged.
        ValueError: the summary is of no experiment that there is.
        OSError: the folder cannot be read or written.
    """
    values = parse_json((folder / "summary.json").read_bytes())
    if not isinstance(values, dict) or not {"experiment", "quick"} <= values.keys():
        raise RecordError(f"{folder / 'summary.json'}: not the summary of a reproduction")
    name, quick = str(values["experiment"]), bool(values["quick"])
    reproduction = find(name)
    write(name, reproduction, folder, quick)
    write_page(reproduction.title, folder, [folder])


def _experiments(panel: Comparison | Computation, quick: bool) -> dict[str, Experiment]:
    return panel.sized(quick) if isinstance(panel, Comparison) else {}


def _check(experiment: Experiment) -> None:
    for entry in experiment.entries:
        if entry.learner.family == "sb3":
            check_sb3(experiment, entry)
        else:
            try_out(experiment, entry, "the setting reward_shift=")


def write(name: str, reproduction: Reproduction, folder: Path, quick: bool) -> None:
    """Write summary.json, summary.md and the figure, light and dark, and print the tables.

    Raises:
        RecordError: records are damaged.
        OSError: the folder cannot be written.
    """
    from baselines.curves import DARK, LIGHT  # imports matplotlib
    from baselines.figures import draw, draw_table

    lines = [panel_lines(panel, folder, quick) for panel in reproduction.panels]
    tables: list[dict[str, Any]] = [
        {
            "name": panel.name,
            "title": panel.title,
            "measure": _label(panel),
            "x": panel.x,
            "rows": panel_rows(panel, found, quick),
        }
        for panel, found in zip(reproduction.panels, lines, strict=True)
    ]
    values = {
        "experiment": name,
        "title": reproduction.title,
        "shape": reproduction.shape,
        "notes": reproduction.notes,
        "quick": quick,
        "failed_runs": _failures(reproduction, folder, quick),
        "command": f"bnprl reproduce {name}{' --quick' * quick}",
        "panels": tables,
    }
    write_atomic(folder / "summary.json", json.dumps(values, indent=2, allow_nan=False) + "\n")
    write_atomic(folder / "summary.md", markdown(values))
    for file, ground in (("figure.png", LIGHT), ("figure-dark.png", DARK)):
        picture = draw_table(reproduction, tables, ground) if _is_table(reproduction) else None
        write_atomic(folder / file, picture or draw(reproduction, lines, tables, ground))
    for panel in tables:
        print(f"== {panel['title']}: {panel['measure']}")
        print_table(cells(panel["rows"], panel["x"]))
    if _is_table(reproduction):
        print(f"== {reproduction.title}")
        print_table(side_by_side(tables))
    print(f"figure: {folder / 'figure.png'}")


def _failures(reproduction: Reproduction, folder: Path, quick: bool) -> dict[str, str]:
    """Return the failed runs of all panels by folder and run, each with why it did."""
    return {
        f"{place}/{name}": reason
        for panel in reproduction.panels
        for place, experiment in _experiments(panel, quick).items()
        for name, reason in failures(read_runs(experiment, folder / place)).items()
    }


def panel_lines(panel: Comparison | Computation, folder: Path, quick: bool) -> Lines:
    """Return what a panel draws: the measure of each contender's runs, or what is computed."""
    if isinstance(panel, Computation):
        return panel.compute(quick)
    found = {}
    for name, experiment in panel.sized(quick).items():
        for contender, runs in finished_runs(read_runs(experiment, folder / name)).items():
            curve = _curves(runs, panel.x, panel.measure) if runs else None
            if curve is not None:
                found[panel.labels.get(contender, contender)] = curve
    return found


def _curves(runs: Sequence[Sequence[Record]], x: str, measure: Measure) -> Any:
    """Return steps or episodes (points,) and the measure (runs, points), on one grid."""
    from baselines.curves import newest, on_one_grid

    known = [newest([r for r in run if measure.of(r) is not None]) for run in runs]
    if not all(known):
        return None
    return on_one_grid(known, x, lambda record: measure.of(record) or 0.0)


def panel_rows(panel: Comparison | Computation, lines: Lines, quick: bool) -> list[Row]:
    """Return the rows of a panel's table: the last values, then references."""
    rows = [_row(label, y[:, -1]) | {"x": float(x[-1])} for label, (x, y) in lines.items()]
    known = [(reference.name, reference.value, reference.source) for reference in panel.references]
    if isinstance(panel, Comparison):
        if panel.computed is not None:
            known += [(found.name, found.value, found.source) for found in panel.computed()]
        if panel.measure.label.endswith("discounted return"):
            environment = panel.experiment.environment
            known += [
                (row["agent"], row["mean"], row["source"]) for row in reference_rows(environment)
            ]
    return rows + [
        _row(name, np.array([value])) | {"source": source} for name, value, source in known
    ]


def _row(label: str, values: Any) -> Row:
    interval = mean_interval(values, seed=zlib.crc32(label.encode()))
    return {
        "agent": label,
        "mean": interval.mean,
        "ci_low": interval.low,
        "ci_high": interval.high,
        "median": float(np.median(values)),
        "seeds": len(values),
        "x": None,
        "source": None,
    }


def _is_table(reproduction: Reproduction) -> bool:
    return reproduction.shape == "table"


def _label(panel: Comparison | Computation) -> str:
    return panel.measure.label if isinstance(panel, Comparison) else panel.y
