"""Learning curves: mean over seeds with its interval, over steps and over seconds."""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.experiment import METRIC, Experiment
from baselines.records import Record
from baselines.statistics import mean_band

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's palette, distinct to all common forms of colour vision."""
STYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
GRID = 200


class Ground(NamedTuple):
    """What a picture is drawn on, and the colour of its axes and words."""

    ink: str
    paper: str


LIGHT, DARK = Ground("#1f2328", "#ffffff"), Ground("#e6e6e6", "#16181c")
LABEL_HEIGHT = 0.045
"""Least distance of two labels, in heights of the axes."""
WIDE_RANGE = 20.0
"""Ratio of the contenders' times from which the axis of seconds is logarithmic."""


def draw_curves(
    experiment: Experiment,
    curves: Mapping[str, Sequence[Sequence[Record]]],
    references: Sequence[Mapping[str, Any]],
    ground: Ground,
) -> bytes:
    """Return a picture (PNG) of the learning curves.

    Args:
        experiment: whose curves.
        curves: contender -> the records of each finished run.
        references: rows of the summary, drawn as horizontal lines.
        ground: what they are drawn on.
    """
    ink, paper = ground
    figure = Figure(figsize=(11, 5.2), facecolor=paper, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, field in ((left, "steps"), (right, "train_seconds")):
        for index, (name, runs) in enumerate(curves.items()):
            if runs:
                _draw(axes, name, index, runs, field, experiment)
        _draw_references(axes, references, ink)
        dress(axes, ground)
    _label_references(right, references, ink)
    left.set(xlabel="environment steps of training", ylabel=METRIC)
    left.xaxis.set_major_formatter(lambda value, _: thousands(value))
    right.set(xlabel="seconds of training")
    times = [run[-1].train_seconds for runs in curves.values() for run in runs]
    if times and max(times) > WIDE_RANGE * max(min(times), 1e-9):
        right.set(xscale="log", xlabel="seconds of training (logarithmic)")
    figure.suptitle(plain(experiment.environment.id), color=ink, fontsize=13)
    handles, names = left.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles,
            names,
            loc="outside lower center",
            ncols=min(6, len(names)),
            frameon=False,
            labelcolor=ink,
            handlelength=3.5,
        )
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    return picture.getvalue()


def _draw(
    axes: Axes,
    name: str,
    index: int,
    runs: Sequence[Sequence[Record]],
    field: str,
    experiment: Experiment,
) -> None:
    """Draw one contender: its curve and band, or a point where it was evaluated once."""
    colour, label = COLOURS[index % len(COLOURS)], plain(name)
    style, marker = STYLES[index // 2 % len(STYLES)], MARKERS[index % len(MARKERS)]
    seed = zlib.crc32(f"{experiment.root_seed} {name}".encode())
    runs = [newest(run) for run in runs]
    grid, values = on_one_grid(runs, field, lambda record: record.return_mean)
    mean, low, high = mean_band(values, seed=seed)
    axes.fill_between(grid, low, high, color=colour, alpha=0.18, linewidth=0)
    if len(grid) == 1:
        error = [mean - low, high - mean]
        axes.errorbar(grid, mean, error, color=colour, fmt=marker, label=label, capsize=4, ms=7)
        return
    axes.plot(
        grid,
        mean,
        style,
        color=colour,
        label=label,
        linewidth=2,
        marker=marker,
        markersize=6,
        markevery=_marks(grid, runs, field),
    )


def newest(run: Sequence[Record]) -> list[Record]:
    """Keep the last of evaluations between which nothing was learned."""
    return list({record.steps: record for record in run}.values())


def on_one_grid(
    runs: Sequence[Sequence[Record]], field: str, value: Callable[[Record], float]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Interpolate runs that were evaluated at different times: (points,), (runs, points).

    The grid begins when every run has been evaluated and ends with the last one: a run that has
    spent its budget keeps its final value, since its policy no longer changes.
    """
    times = [np.array([getattr(record, field) for record in run], dtype=float) for run in runs]
    values = [np.array([value(record) for record in run]) for run in runs]
    first, last = max(time[0] for time in times), max(time[-1] for time in times)
    if min(len(time) for time in times) < 2 or first >= last:
        return (
            np.array([np.mean([time[-1] for time in times])]),
            np.array([[curve[-1]] for curve in values]),
        )
    grid = np.linspace(first, last, GRID)
    return grid, np.array([np.interp(grid, t, v) for t, v in zip(times, values, strict=True)])


def _marks(
    grid: npt.NDArray[np.float64], runs: Sequence[Sequence[Record]], field: str
) -> list[int]:
    """Return the grid points nearest to the first run's evaluations."""
    times = [getattr(record, field) for record in runs[0]]
    return sorted({int(np.abs(grid - time).argmin()) for time in times})


def _draw_references(axes: Axes, references: Sequence[Mapping[str, Any]], ink: str) -> None:
    for row in references:
        axes.axhline(row["mean"], color=ink, linewidth=0.9, linestyle=(0, (1, 2)), alpha=0.75)


def _label_references(axes: Axes, references: Sequence[Mapping[str, Any]], ink: str) -> None:
    """Write the names beside the lines, apart from each other where values are close."""
    bottom, top = axes.get_ylim()
    height = -1.0
    for row in sorted(references, key=lambda row: float(row["mean"])):
        height = max((row["mean"] - bottom) / (top - bottom), height + LABEL_HEIGHT)
        text = plain(f" {row['agent']} {row['mean']:.3g}")
        axes.annotate(text, (1.0, height), xycoords="axes fraction", va="center", color=ink, size=9)


def plain(text: str) -> str:
    """Return a text as Matplotlib draws it letter by letter, dollar signs included."""
    return text.replace("$", r"\$")


def dress(axes: Axes, ground: Ground) -> None:
    """Give axes the colours, the grid and the two spines of all pictures."""
    ink, paper = ground
    axes.set_facecolor(paper)
    axes.grid(color=ink, alpha=0.12, linewidth=0.7)
    axes.tick_params(colors=ink, which="both")
    axes.xaxis.label.set_color(ink)
    axes.yaxis.label.set_color(ink)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(ink)


def thousands(value: float) -> str:
    """Return a count of steps in few characters: 250k, 1.5M."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{unit}"
    return f"{value:g}"
